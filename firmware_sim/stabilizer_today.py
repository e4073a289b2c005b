"""Today's loops: cascaded PIDs at 500 Hz, mixer, battery compensation.

Signs as in ``stabilizer``: angles in degrees, pitch nose up; the rate loop measures
(gyro.x, -gyro.y, gyro.z). A yaw setpoint, clockwise, turns the heading that is held. Thrust is
asked for as a share of the most that the firmware's own thrust curve gives, so what a motor gets
depends on the battery: PWM times battery voltage is what the curve wants.
"""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.layout import Record
from firmware_sim.releases import GRAMS, VOLTS_OF_GRAMS
from firmware_sim.supervisor import may_run
from groundstation.telemetry.packet import FULL_16_BIT

DT = 0.002
INT16_MAX = 32767.0
RATE_LIMIT = (33.3, 33.3, 166.7)
ANGLE_LIMIT = (20.0, 20.0, 360.0)
LEAST_SUPPLY_V = 2.0
"""Below it the firmware leaves the battery out."""
MOST_MOTOR_V = 5.0
NEWTON_STEPS = 6
PER_GRAM, PER_SQUARE_GRAM = VOLTS_OF_GRAMS


@inner
def stabilize_today(fw: Record) -> None:
    """One pass: leaves 16-bit PWM in ``fw.pwm``."""
    runs = may_run(fw)
    if not runs:
        fw.thrust = 0.0
    if fw.thrust <= 0.0:
        for axis in range(3):
            fw.rate_integral[axis] = 0.0
            fw.rate_previous[axis] = 0.0
            fw.angle_integral[axis] = 0.0
            fw.angle_previous[axis] = fw.angles[axis]
        fw.heading = fw.angles[2]
        for i in range(4):
            fw.pwm[i] = fw.idle if runs else 0
            fw.commands[i] = 0.0
        return
    fw.heading = _turned(fw.heading - fw.setpoint[2] * DT)
    for axis in range(3):
        error = fw.setpoint[axis] - fw.angles[axis] if axis < 2 else fw.heading - fw.angles[2]
        fw.rate_desired[axis] = _update(
            fw.angle_integral,
            axis,
            _turned(error),
            _turned(fw.angles[axis] - fw.angle_previous[axis]),
            fw.angle_kp[axis],
            fw.angle_ki[axis],
            fw.angle_kd[axis],
            ANGLE_LIMIT[axis],
        )
        fw.angle_previous[axis] = fw.angles[axis]
    fw.commands[0] = thrust = fw.thrust
    fw.commands[1] = _rate_loop(fw, 0, fw.gyro[0])
    fw.commands[2] = _rate_loop(fw, 1, -fw.gyro[1])
    fw.commands[3] = yaw = -_rate_loop(fw, 2, fw.gyro[2])
    roll, pitch = float(int(fw.commands[1] / 2.0)), float(int(fw.commands[2] / 2.0))
    mixed = (
        thrust - roll + pitch + yaw,
        thrust - roll - pitch - yaw,
        thrust + roll - pitch + yaw,
        thrust + roll + pitch - yaw,
    )
    highest = FULL_16_BIT
    for i in range(4):
        fw.wanted[i] = compensated(fw, mixed[i])
        highest = max(highest, fw.wanted[i])
    for i in range(4):
        # attitude comes before thrust: all are lowered together
        fw.pwm[i] = int(max(fw.wanted[i] - (highest - FULL_16_BIT), float(fw.idle)))


@inner
def compensated(fw: Record, thrust: float) -> float:
    """PWM (16 bits, not yet limited) that gives a thrust (16 bits) at the battery's voltage."""
    supply_v = fw.battery_filter
    if thrust <= 0.0 or supply_v < LEAST_SUPPLY_V or fw.compensates == 0:
        return thrust
    if fw.by_grams != 0:
        grams = thrust / FULL_16_BIT * GRAMS
        return grams * (PER_GRAM + PER_SQUARE_GRAM * grams) / supply_v * FULL_16_BIT
    wanted_n = thrust / FULL_16_BIT * fw.thrust_most_n
    if wanted_n < fw.thrust_least_n:
        return 0.0
    c0, c1, c2, c3 = fw.thrust_curve[0], fw.thrust_curve[1], fw.thrust_curve[2], fw.thrust_curve[3]
    volts = 2.0
    for _ in range(NEWTON_STEPS):
        value = c0 + volts * (c1 + volts * (c2 + volts * c3)) - wanted_n
        slope = c1 + volts * (2.0 * c2 + 3.0 * volts * c3)
        volts = min(max(volts - value / slope, 0.0), MOST_MOTOR_V)
    return volts / supply_v * FULL_16_BIT


@inner
def _rate_loop(fw: Record, axis: int, measured: float) -> float:
    output = _update(
        fw.rate_integral,
        axis,
        fw.rate_desired[axis] - measured,
        measured - fw.rate_previous[axis],
        fw.rate_kp[axis],
        fw.rate_ki[axis],
        fw.rate_kd[axis],
        RATE_LIMIT[axis],
    )
    fw.rate_previous[axis] = measured
    return min(max(output, -INT16_MAX), INT16_MAX)


@inner
def _update(
    integral: Any,
    axis: int,
    error: float,
    change: float,
    kp: float,
    ki: float,
    kd: float,
    limit: float,
) -> float:
    """change: of the measurement, whose derivative it is: a step of the setpoint does not kick."""
    integral[axis] = min(max(integral[axis] + error * DT, -limit), limit)
    return kp * error + ki * integral[axis] - kd * change / DT


@inner
def _turned(degrees: float) -> float:
    """The same direction within half a turn."""
    while degrees > 180.0:
        degrees -= 360.0
    while degrees < -180.0:
        degrees += 360.0
    return degrees
