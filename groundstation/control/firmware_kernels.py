"""What the firmware computes in its loops, compiled: PIDs, thrust curve, attitude filter. ``f`` is
its state (``firmware_loop.py``)."""

from __future__ import annotations

from typing import Any

from groundstation.compiled import spliced
from groundstation.dynamics.sensing import fuse
from groundstation.telemetry.packet import FULL_16_BIT


@spliced
def update(
    f: Any,
    kind: int,
    axis: int,
    error: float,
    dt: float,
    limit: float,
    kp: float,
    ki: float,
    kd: float,
) -> float:
    """One PID of release 2014.01.0: its integral is clamped, at -5000 below, its output is not."""
    value = min(max(f.integral[kind, axis] + error * dt, -5000.0), limit)
    f.integral[kind, axis] = value
    output = kp * error + ki * value + kd * (error - f.previous[kind, axis]) / dt
    f.previous[kind, axis] = error
    return float(output)


@spliced
def rate_pid(f: Any, axis: int, error: float) -> float:
    """A rate PID as the clamp macro evaluates it: up to three times, within 16 bits."""
    output = 0.0
    for evaluation in range(3):
        output = update(
            f,
            1,
            axis,
            error,
            0.002,
            f.rate_limit[axis],
            f.rate_kp[axis],
            f.rate_ki[axis],
            f.rate_kd[axis],
        )
        if evaluation == 0 and output < -32768.0:
            break
        if evaluation == 1 and output > 32767.0:
            break
    return min(max(output, -32768.0), 32767.0)


@spliced
def update_today(
    f: Any,
    kind: int,
    axis: int,
    error: float,
    measured: float,
    limit: float,
    kp: float,
    ki: float,
    kd: float,
) -> float:
    """One PID of today's firmware: the derivative is that of what is measured, in deg or deg/s."""
    value = min(max(f.integral[kind, axis] + error * 0.002, -limit), limit)
    f.integral[kind, axis] = value
    change = measured - f.previous[kind, axis]
    if kind == 0:
        change = wrapped(change)
    f.previous[kind, axis] = measured
    return float(kp * error + ki * value - kd * change / 0.002)


@spliced
def rate_today(f: Any, axis: int, wanted: float, measured: float) -> float:
    output = update_today(
        f,
        1,
        axis,
        wanted - measured,
        measured,
        f.rate_limit[axis],
        f.rate_kp[axis],
        f.rate_ki[axis],
        f.rate_kd[axis],
    )
    return min(max(output, -32767.0), 32767.0)


@spliced
def wrapped(degrees: float) -> float:
    """The same direction within half a turn."""
    return (degrees + 180.0) % 360.0 - 180.0


@spliced
def compensated(f: Any, thrust: float, supply_v: float) -> float:
    """PWM (16 bits, not yet limited) by which the firmware's thrust curve gives a thrust."""
    if thrust <= 0.0:
        return 0.0
    wanted, volts = thrust / FULL_16_BIT * f.most_n, 2.0
    c = f.curve
    for _ in range(6):
        value = c[0] + volts * (c[1] + volts * (c[2] + volts * c[3])) - wanted
        slope = c[1] + volts * (2.0 * c[2] + 3.0 * volts * c[3])
        volts = min(max(volts - value / slope, 0.0), 5.0)
    return volts / supply_v * FULL_16_BIT


@spliced
def fused(f: Any, gyro: Any, felt: Any) -> Any:
    """The firmware's Mahony update at 250 Hz; returns its quaternion."""
    q, kept = f.quaternion, f.feedback
    gains = (0.5 * f.fusion_kp, 0.5 * f.fusion_ki)
    integral = (kept[0], kept[1], kept[2])
    turned, integral = fuse((q[0], q[1], q[2], q[3]), integral, gyro, felt, gains, 0.004)
    q[0], q[1], q[2], q[3] = turned
    kept[0], kept[1], kept[2] = integral
    return turned
