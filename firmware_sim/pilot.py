"""The pilot: eyes on the craft, hands on the sticks, a programme to fly.

Each 10 ms: the programme's roll, pitch and yaw, plus small corrections that keep the craft in
the room and its nose forward, and a thrust that holds the height asked for. When the firmware
reports a low battery the pilot lands.
"""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.commander import MAX_THRUST, MIN_THRUST, accept
from firmware_sim.compiled import inner
from firmware_sim.layout import (
    FREE,
    HELD,
    PASS_NS,
    PILOT_PASSES,
    ROW_KEEP,
    ROW_LEVEL,
    ROW_MODE,
    ROW_PITCH,
    ROW_PUSH,
    ROW_ROLL,
    ROW_THRUST,
    ROW_YAW,
    THRUST_DIRECT,
    THRUST_HEIGHT,
    Record,
)
from firmware_sim.supervisor import LANDED, PASSED

TICK_S = PILOT_PASSES * PASS_NS * 1e-9
DEGREES = 180.0 / math.pi
CLIMB_M_S = 0.4
"""How fast the pilot moves the height he wants."""
HEIGHT_GAIN, SPEED_GAIN, HEIGHT_INTEGRAL = 4.0, 3.6, 1.5
"""Wanted acceleration (m/s^2) per m, per m/s and per m s."""
LEAN_LIMIT = 15.0
LEAN_POSITION, LEAN_SPEED = 5.8, 9.3
"""Correction of position in deg per m and deg per m/s (1 rad/s, damping 0.8)."""
PER_THRUST = 1.0 / 1.7
"""Thrust grows with the 1.7th power of a PWM around hover; today's firmware takes thrust itself."""
HEADING_GAIN = 1.0
LANDED_M = 0.012
REST_NS = 2_000_000_000


@inner
def decide(p: Record, fw: Record, s: Record, row: Any, hover: float, now_ns: int) -> None:
    """One decision of the pilot; ``hover`` is the 16-bit thrust that carries the craft."""
    s.mode = row[ROW_MODE]
    if s.mode == HELD:
        s.target[0] = row[ROW_ROLL] / DEGREES
        s.target[1] = row[ROW_PITCH] / DEGREES
        s.target[2] = row[ROW_YAW] / DEGREES
    if fw.client_ns >= 0 and now_ns - fw.client_ns < p.resume_ns:
        holds = fw.altitude_hold > 0.0 and fw.pilot_holds != 0
        if holds and fw.setpoint_thrust > MIN_THRUST and fw.thrust > 0.0:
            fw.setpoint_thrust = hold_height(p, fw, s, p.hold_height, 0.0, hover)
        return
    if s.mode == HELD:
        accept(fw, now_ns, 0.0, 0.0, 0.0, 0.0)
        return
    roll, pitch, yaw = row[ROW_ROLL], row[ROW_PITCH], row[ROW_YAW]
    wanted = row[ROW_LEVEL]
    height_held = row[ROW_THRUST] == THRUST_HEIGHT
    keep = row[ROW_KEEP]
    push = row[ROW_PUSH]
    if p.land_when_low != 0 and fw.power_state == 3:
        s.landing = 1
    if s.landing != 0:
        roll, pitch, yaw, wanted, keep, push = 0.0, 0.0, 0.0, 0.0, 1.0, 0.0
    if keep > 0.0 and s.mode == FREE:
        lean_roll, lean_pitch, turn = correct(s)
        roll += keep * lean_roll
        pitch += keep * lean_pitch
        if row[ROW_YAW] == 0.0:
            yaw += keep * turn
    thrust = 0.0
    if row[ROW_THRUST] == THRUST_DIRECT:
        thrust = wanted
    elif height_held:
        thrust = hold_height(p, fw, s, wanted, push, hover)
    if fw.supervisor == PASSED and thrust > 0.0:
        fw.armed = 1  # a pilot arms before he flies
    elif fw.supervisor == LANDED and thrust <= 0.0:
        fw.armed = fw.arms_itself  # and lets no motors idle on the ground
    accept(fw, now_ns, roll, pitch, yaw, thrust)


@inner
def hold_height(
    p: Record, fw: Record, s: Record, wanted: float, share: float, hover: float
) -> float:
    """16-bit thrust that brings the craft to a height (m); 0 once it stands and is to stand.

    share: of the hover thrust, a push on top that the programme asks for.
    """
    height, climb = s.y[2], s.y[5]
    if fw.thrust <= 0.0:
        s.pilot_integral = 0.0
        s.pilot_height = min(height, 0.0)
        if wanted <= LANDED_M:
            return 0.0
    step = CLIMB_M_S * TICK_S
    if s.pilot_height < wanted:
        s.pilot_height = min(s.pilot_height + step, wanted)
        speed = CLIMB_M_S if s.pilot_height < wanted else 0.0
    else:
        s.pilot_height = max(s.pilot_height - step, wanted - 0.1 if wanted <= LANDED_M else wanted)
        speed = -CLIMB_M_S if s.pilot_height > wanted else 0.0
    if wanted <= LANDED_M and height < LANDED_M and s.pilot_height <= LANDED_M:
        return 0.0
    error = s.pilot_height - height
    if height > LANDED_M or s.pilot_integral < 0.0:
        s.pilot_integral += HEIGHT_INTEGRAL * error * TICK_S
    s.pilot_integral = min(max(s.pilot_integral, -4.0), 4.0)
    push = HEIGHT_GAIN * error + SPEED_GAIN * (speed - climb) + s.pilot_integral
    ratio = min(max(1.0 + push / p.gravity + share, 0.3), 2.0)
    thrust = hover * (ratio if fw.today != 0 else math.pow(ratio, PER_THRUST))
    return min(max(thrust, MIN_THRUST + 1.0), MAX_THRUST)


@inner
def correct(s: Record) -> Any:
    """Roll, pitch (deg, nose up) and yaw rate (deg/s, clockwise) that bring the craft back."""
    y = s.y
    w, a, b, c = y[6], y[7], y[8], y[9]
    heading = math.atan2(2 * (a * b + w * c), 1 - 2 * (b * b + c * c))
    cosine, sine = math.cos(heading), math.sin(heading)
    ahead, aside = cosine * y[0] + sine * y[1], -sine * y[0] + cosine * y[1]
    forward, leftward = cosine * y[3] + sine * y[4], -sine * y[3] + cosine * y[4]
    pitch = LEAN_POSITION * ahead + LEAN_SPEED * forward
    roll = LEAN_POSITION * aside + LEAN_SPEED * leftward
    return (
        min(max(roll, -LEAN_LIMIT), LEAN_LIMIT),
        min(max(pitch, -LEAN_LIMIT), LEAN_LIMIT),
        HEADING_GAIN * heading * DEGREES,
    )
