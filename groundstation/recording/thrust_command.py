"""Whether ``motor.m1..m4`` of a Crazyflie 2.x are its motors' duty, or thrust that was asked for.

Firmware before November 2022 logs them before it compensates for the battery (crazyflie-firmware
#77): thrust of 60 g at full scale, which becomes V = 0.088 t - 0.0006239 t^2 and then duty = V over
the battery's voltage. ``pwm.m1_pwm`` is the duty in every release. Of the duty, thrust changes with
duty times voltage; of the command, with the command alone: a flight in which the voltage changes
enough beside the duty tells them apart.
"""

from __future__ import annotations

import re
from typing import Literal

import numpy as np

from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import SampleBatch

FULL_THRUST_G, V_PER_G, V_PER_G2 = 60.0, 0.088, -0.0006239
"""The firmware's compensation, of one motor (motors.c before November 2022)."""
WINDOW_S, WINDOWS = 0.25, 20
"""Rows are averaged over so long, above the motors' lag and the time between two batteries' values;
fewer windows tell nothing."""
TURNS = (0.15, 0.98)
"""Duties between which a motor carries and is not saturated."""
FITS, EXCLUDED = 3.0, 5.0
"""Standard errors within which one reading agrees and beyond which the other does not."""
DUTY_POWER, COMMAND_POWER = (1.2, 2.2), (0.7, 1.5)
"""Powers of thrust by the duty (a propeller's is 2 by its speed) and by a command of thrust: other
powers say that something else moved the accelerometer. Of 15 real flights, with the duty and with a
command made of it, the longest is told, both ways, and none wrongly."""
LAGS = 4
"""Windows over which residuals may depend on each other (Newey and West 1987)."""
_COMMAND = re.compile(r"(?:^|[./])motor\.m[1-4]$")
_RENAMED = re.compile(r"(?:^|[._/ ])motor[._/]m[1-4]$")
"""The same as other programs write them: ``log_motor_m1``, ``motor/m1``."""
NOT_KNOWN = (
    "the motors' duty is not known: motor.m1 to m4 are logged, which firmware before November 2022"
    " has before battery compensation; constants may be 25 % off (log pwm.m1_pwm to m4_pwm)"
)
MADE = (
    "motor.m1 to m4 are the thrust that was asked for, as thrust and battery show (firmware before"
    " November 2022); the duty is computed with the battery by that firmware's formula"
)
DIFFERS = (
    "motor.m1 to m4 differ from pwm.m1_pwm to m4_pwm (firmware before November 2022 logs them"
    " before battery compensation): the duty is pwm.*"
)


def is_command(column: str | int, craft_known: bool = False) -> bool:
    """Whether a column is the firmware's ``motor.m1..m4``. craft_known: its map names the vehicle,
    and with other names its firmware: only the firmware's own name is doubted then."""
    return (_COMMAND if craft_known else _RENAMED).search(str(column)) is not None


def told_by_flight(samples: SampleBatch) -> Literal["duty", "command", ""]:
    """What the motors' column is, by thrust against battery; empty where the flight does not tell.

    Of windows in the air: log thrust = a + b log(column) + c log(voltage), where c = b of the duty
    and c = 0 of the command."""
    duty = samples.duty.astype(np.float64)
    force = samples.accelerometer[:, 2].astype(np.float64)
    voltage = samples.battery_v.astype(np.float64)
    good = np.isfinite(duty).all(axis=1) & (force > 3.0) & (voltage > 2.0)
    good &= (duty > TURNS[0]).all(axis=1) & (duty < TURNS[1]).all(axis=1)
    if not good.any():
        return ""
    window = np.floor(samples.time_s / WINDOW_S).astype(np.int64)
    window += samples.segment.astype(np.int64) * (int(np.ptp(window)) + 2)
    _, place, rows = np.unique(window, return_inverse=True, return_counts=True)
    whole = np.bincount(place[good], minlength=len(rows)) >= np.maximum(3, 0.9 * rows)
    count = np.bincount(place[good], minlength=len(rows))[whole]
    if len(count) < WINDOWS:
        return ""

    def mean(values: Array) -> Array:
        return np.bincount(place[good], values[good], len(rows))[whole] / count

    thrust, supply = np.log(mean(force)), np.log(mean(voltage))
    asked = 0.5 * np.log(mean((duty**2).mean(axis=1)))
    found = _slopes(thrust, asked, supply)
    if found is None:
        return ""
    slope, covariance = found
    apart = abs(slope[2] - slope[1])
    of_duty = apart / np.sqrt(covariance[1, 1] + covariance[2, 2] - 2 * covariance[1, 2])
    of_command = abs(slope[2]) / np.sqrt(covariance[2, 2])
    power = float(slope[1])
    if of_duty < FITS and of_command > EXCLUDED and DUTY_POWER[0] < power < DUTY_POWER[1]:
        return "duty"
    if of_command < FITS and of_duty > EXCLUDED and COMMAND_POWER[0] < power < COMMAND_POWER[1]:
        return "command"
    return ""


def duty_of_command(command: Array, battery_v: Array) -> Array:
    """The duty (n, 4) that the firmware makes of its command (n, 4), 0..1, with the battery's
    voltage (n,)."""
    thrust_g = FULL_THRUST_G * command
    volts = V_PER_G * thrust_g + V_PER_G2 * thrust_g**2
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.clip(volts / battery_v[:, None], 0.0, 1.0)


def settle_duty(samples: SampleBatch) -> tuple[str, str]:
    """Decide of samples that have ``motor.m1..m4`` in the duty's place, and make it the duty: a
    note, and what stays open, either empty."""
    if not np.isfinite(samples.duty).any():
        return "", ""
    said = told_by_flight(samples)
    if said == "command":
        duty = duty_of_command(
            samples.duty.astype(np.float64), samples.battery_v.astype(np.float64)
        )
        samples.duty[:] = duty
        return MADE, ""
    return "", "" if said == "duty" else NOT_KNOWN


def differs(command: Array, duty: Array) -> bool:
    """Whether ``motor.m1`` and ``pwm.m1_pwm`` (n,), both 0..1, are not one quantity: they are apart
    by an 8-bit count in more than a tenth of the rows in which the motor turns."""
    both = np.isfinite(command) & np.isfinite(duty) & ((command > 0.0) | (duty > 0.0))
    apart = np.abs(command[both] - duty[both]) > 1.0 / 255.0
    return bool(len(apart) and apart.mean() > 0.1)


@np.errstate(all="ignore")
def _slopes(thrust: Array, asked: Array, supply: Array) -> tuple[Array, Array] | None:
    """Robust regression of thrust on what was asked and on the supply (n,): coefficients (3,) and
    their covariance, which allows for residuals that depend on each other."""
    design = np.column_stack([np.ones(len(thrust)), asked, supply])
    weight = np.ones(len(thrust))
    try:
        for _ in range(10):
            root = np.sqrt(weight)
            slope = np.linalg.lstsq(design * root[:, None], thrust * root, rcond=None)[0]
            left = thrust - design @ slope
            scale = 1.4826 * float(np.median(np.abs(left))) + 1e-9
            weight = np.minimum(1.0, 2.0 * scale / np.maximum(np.abs(left), 1e-12))
        inverse = np.linalg.inv((design * weight[:, None]).T @ design)
    except np.linalg.LinAlgError:
        return None
    score = design * (weight * left)[:, None]
    middle = score.T @ score
    for lag in range(1, LAGS + 1):
        cross = score[lag:].T @ score[:-lag]
        middle += (1.0 - lag / (LAGS + 1)) * (cross + cross.T)
    covariance = inverse @ middle @ inverse
    sound = np.isfinite(covariance).all() and (np.diag(covariance) > 0.0).all()
    return (slope, covariance) if sound else None
