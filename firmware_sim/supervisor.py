"""The supervisor of today's firmware: whether motors may run, and what takes that away.

25 times a second it goes at most one state further. A craft whose setpoints stop for 2 s while it
flies, or within 2 s after its motors last turned, is locked until it is switched off and on: who
lands must go on sending zero thrust until it calls itself landed. It begins when the gyro's bias
has been found: until then nothing can be armed.
"""

from __future__ import annotations

from firmware_sim.commander import LEVEL_NS, STOP_NS
from firmware_sim.compiled import inner
from firmware_sim.layout import Record

EVERY_PASSES = 20
NOT_PASSED, PASSED, READY, FLYING, LANDED, LEVEL_OUT, LOCKED, CRASHED = range(8)
CAN_FLY = (READY, FLYING, LANDED, LEVEL_OUT)

FLYING_NS = 2_000_000_000
"""Motors that turned faster than they idle, within so long, are those of a craft that flies."""
LANDED_NS, PREFLIGHT_NS = 3_000_000_000, 30_000_000_000
"""After a landing, and without a take-off, it is disarmed."""
FREE_FALL_G = 0.1
TILTED_G, TILTED_NS = 0.5, 1_000_000_000
UPSIDE_DOWN_G, UPSIDE_DOWN_NS = -0.2, 100_000_000
"""Specific force along z below which, for longer than that, a craft has tumbled."""

CRASHES, DISARMS_SAFELY = 8, 9
"""Protocols from which on a craft that tumbles in flight has crashed, and a craft that is disarmed
in flight is not locked; before, both are locked."""


@inner
def supervise(fw: Record, now_ns: int) -> None:
    """One step, behind which ``fw.armed`` and ``fw.supervisor`` say whether motors may run."""
    _watch_attitude(fw, now_ns)
    for i in range(4):
        if fw.pwm[i] > fw.idle:
            fw.turned_ns = now_ns
    flies = fw.turned_ns >= 0 and now_ns - fw.turned_ns < FLYING_NS
    before = fw.supervisor
    state = _next(fw, now_ns, flies)
    if state == before:
        return
    fw.supervisor, fw.supervised_ns = state, now_ns
    if state in (NOT_PASSED, PASSED, LOCKED, CRASHED):
        fw.armed = fw.arms_itself if state == PASSED else 0


@inner
def may_run(fw: Record) -> bool:
    """Whether motors may run."""
    if fw.armed == 0 or fw.stopped != 0 or fw.tumbled != 0:
        return False
    return bool(fw.supervisor in CAN_FLY)


@inner
def _next(fw: Record, now_ns: int, flies: bool) -> int:
    state, since_ns = fw.supervisor, now_ns - fw.supervised_ns
    age_ns = now_ns - fw.setpoint_ns
    stopped, tumbled, armed = fw.stopped != 0, fw.tumbled != 0, fw.armed != 0
    if state == NOT_PASSED:
        return LOCKED if stopped else NOT_PASSED if tumbled else PASSED
    if state == PASSED:
        return LOCKED if stopped else NOT_PASSED if tumbled else READY if armed else PASSED
    if state == READY:
        if stopped:
            return LOCKED
        waits_too_long = fw.protocol >= DISARMS_SAFELY and since_ns > PREFLIGHT_NS
        if tumbled or not armed or waits_too_long:
            return NOT_PASSED
        return FLYING if flies else READY
    if state == FLYING:
        if stopped or age_ns > STOP_NS or (not armed and fw.protocol < DISARMS_SAFELY):
            return LOCKED
        if tumbled:
            return CRASHED if fw.protocol >= CRASHES else LOCKED
        if not armed:
            return NOT_PASSED
        return LEVEL_OUT if age_ns > LEVEL_NS else FLYING if flies else LANDED
    if state == LANDED:
        if not armed or since_ns > LANDED_NS or fw.protocol < CRASHES:
            return NOT_PASSED
        return FLYING if flies else LANDED
    if state == LEVEL_OUT:
        if stopped or tumbled or age_ns > STOP_NS:
            return LOCKED
        return FLYING if age_ns <= LEVEL_NS else LEVEL_OUT
    return LOCKED if stopped else state


@inner
def _watch_attitude(fw: Record, now_ns: int) -> None:
    x, y, z = abs(fw.accel[0]), abs(fw.accel[1]), abs(fw.accel[2])
    if max(x, y, z) < FREE_FALL_G:
        fw.tilted_ns = -1
    fw.tumbled = 0
    if fw.accel[2] >= TILTED_G:
        fw.tilted_ns = -1
        return
    if fw.tilted_ns < 0:
        fw.tilted_ns = now_ns
    tilted_ns = now_ns - fw.tilted_ns
    if tilted_ns > TILTED_NS or (fw.accel[2] < UPSIDE_DOWN_G and tilted_ns > UPSIDE_DOWN_NS):
        fw.tumbled = 1
