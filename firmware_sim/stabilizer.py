"""Cascaded PIDs, mixer and PWM of release 2014.01.0, its quirks behind one switch each.

Signs: roll and pitch setpoints and angles in degrees, pitch nose up; the rate loop measures
(gyro.x, -gyro.y, gyro.z); a yaw setpoint turns clockwise. Outputs are 16-bit PWM units.
"""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.layout import Record
from groundstation.telemetry.packet import FULL_16_BIT

RATE_DT = 0.002
ANGLE_DT = 0.004
QUIRKY_ANGLE_DT = 0.002
"""The release initialises the angle loops with the rate loops' period."""
RATE_LIMIT = (100.0, 100.0, 500.0)
ANGLE_LIMIT = (20.0, 20.0, 360.0)
LOWER_LIMIT = 5000.0
"""The release sets only the upper limit of an integral; this is what the lower one stays at."""
INT16_MAX = 32767.0
INT16_MIN = -32768.0


@inner
def angle_loops(fw: Record) -> None:
    """Rates (deg/s) that bring the angles to the setpoint; yaw is commanded as a rate."""
    dt = QUIRKY_ANGLE_DT if fw.quirk_attitude_dt != 0 else ANGLE_DT
    for axis in range(2):
        error = fw.setpoint[axis] - fw.angles[axis]
        fw.rate_desired[axis] = _update(
            fw.angle_integral,
            fw.angle_previous,
            axis,
            error,
            dt,
            fw.angle_kp[axis],
            fw.angle_ki[axis],
            fw.angle_kd[axis],
            ANGLE_LIMIT[axis],
            fw.quirk_lower_limit,
        )
    fw.rate_desired[2] = -fw.setpoint[2]


@inner
def rate_loop(fw: Record, axis: int, measured: float) -> float:
    """Output of one rate PID, truncated to 16 bits.

    With the quirk of the clamp macro its argument, the PID's update, is evaluated up to three
    times: a result in range has integrated three times and differentiated equal errors.
    """
    error = fw.rate_desired[axis] - measured
    evaluations = 3 if fw.quirk_clamp_macro != 0 else 1
    output = 0.0
    for evaluation in range(evaluations):
        output = _update(
            fw.rate_integral,
            fw.rate_previous,
            axis,
            error,
            RATE_DT,
            fw.rate_kp[axis],
            fw.rate_ki[axis],
            fw.rate_kd[axis],
            RATE_LIMIT[axis],
            fw.quirk_lower_limit,
        )
        if evaluation == 0 and output < INT16_MIN:
            break
        if (evaluation == 1 or evaluations == 1) and output > INT16_MAX:
            break
    return float(int(min(max(output, INT16_MIN), INT16_MAX)))


@inner
def stabilize(p: Record, fw: Record) -> None:
    """Rate PIDs, mixer and PWM of one pass: leaves ``fw.compare``."""
    roll = rate_loop(fw, 0, fw.gyro[0])
    pitch = rate_loop(fw, 1, -fw.gyro[1])
    yaw_output = rate_loop(fw, 2, fw.gyro[2])
    if fw.thrust <= 0.0:
        reset(fw)
        for i in range(4):
            fw.compare[i] = 0
        return
    yaw = -yaw_output
    if yaw > INT16_MAX:
        yaw = INT16_MIN if fw.quirk_negate != 0 else INT16_MAX
    if p.airframe_x != 0:
        roll, pitch = float(int(roll) >> 1), float(int(pitch) >> 1)
        mixed = (
            fw.thrust - roll + pitch + yaw,
            fw.thrust - roll - pitch - yaw,
            fw.thrust + roll - pitch + yaw,
            fw.thrust + roll + pitch - yaw,
        )
    else:
        mixed = (
            fw.thrust + pitch + yaw,
            fw.thrust - roll - yaw,
            fw.thrust - pitch + yaw,
            fw.thrust + roll - yaw,
        )
    for i in range(4):
        fw.compare[i] = int(min(max(mixed[i], 0.0), FULL_16_BIT)) >> 7


@inner
def reset(fw: Record) -> None:
    """Forget the integrals and the last errors: the only place where the release does."""
    for axis in range(3):
        fw.rate_integral[axis] = 0.0
        fw.rate_previous[axis] = 0.0
        fw.angle_integral[axis] = 0.0
        fw.angle_previous[axis] = 0.0


@inner
def _update(
    integral: Any,
    previous: Any,
    axis: int,
    error: float,
    dt: float,
    kp: float,
    ki: float,
    kd: float,
    limit: float,
    lopsided: int,
) -> float:
    lower = -LOWER_LIMIT if lopsided != 0 else -limit
    integral[axis] = min(max(integral[axis] + error * dt, lower), limit)
    output = kp * error + ki * integral[axis] + kd * (error - previous[axis]) / dt
    previous[axis] = error
    return output
