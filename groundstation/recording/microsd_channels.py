"""From the firmware's log variables to samples: names, units, signs.

| variables | meaning |
|---|---|
| gyro.x y z | body rates, body FLU; deg/s in the firmware, see ``gyro_unit_of`` |
| acc.x y z | specific force in g |
| motor.m1..m4, pwm.m1_pwm..m4_pwm | PWM of full scale 65535 (255 where stored in one byte) |
| rpm.m1..m4 | measured rotor speed, rev/min |
| pm.vbatMV, pm.vbat | battery, mV or V |
| stateEstimate.qw qx qy qz | attitude, body FLU in ENU |
| stateEstimate.roll pitch yaw | attitude in deg where there is no quaternion; pitch nose up |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import attitude_of_quaternion, body_rates
from groundstation.recording.motor_columns import changes, siblings, too_many
from groundstation.telemetry.packet import FULL_16_BIT, STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch, empty_samples

GyroUnit = Literal["deg/s", "rad/s"]
Columns = Mapping[str, NDArray[Any]]

GYRO_FULL_SCALE_DEG_S = 2000.0
"""Range of the gyro in every Crazyflie (MPU-9250, BMI088)."""
COMMANDS = tuple(f"motor.m{m}" for m in range(1, 5))
DUTIES = tuple(f"pwm.m{m}_pwm" for m in range(1, 5))
_RATE_LAG = 10
_TURNING_RAD_S = 0.1


@dataclass(frozen=True, slots=True)
class MotorColumns:
    """names: of the four variables, of one source. note: why not of the duty's. crowd: why these
    are no quadrotor's, or empty."""

    names: tuple[str, ...]
    note: str = ""
    crowd: str = ""

    @property
    def are_commands(self) -> bool:
        return self.names == COMMANDS


def motor_columns_of(columns: Columns) -> MotorColumns:
    """The duty's where all four are there and move, else the command's: never some of each."""
    duties, commands = ([one for one in all_ if one in columns] for all_ in (DUTIES, COMMANDS))
    names, note = (DUTIES if duties else COMMANDS), ""
    if duties and len(commands) == 4:
        if len(duties) < 4:
            names, note = COMMANDS, f"only {', '.join(duties)} of pwm.m1_pwm to m4_pwm"
        elif not _changes(columns, DUTIES).any() and _changes(columns, COMMANDS).any():
            names, note = COMMANDS, "pwm.m1_pwm to m4_pwm never change"
    elif duties and len(commands) > len(duties):
        names, note = COMMANDS, f"only {', '.join(duties)} of pwm.m1_pwm to m4_pwm"
    also = siblings([*COMMANDS, *DUTIES], list(columns))
    there = [one for one in names if one in columns]
    crowd = too_many(_changes(columns, there), _changes(columns, also), also) if also else ""
    return MotorColumns(names, f"{note}: the motors are motor.m1 to m4" if note else "", crowd)


def _changes(columns: Columns, names: Sequence[str]) -> NDArray[np.intp]:
    if not names:
        return np.zeros(0, np.intp)
    return changes(np.column_stack([columns[name].astype(np.float64) for name in names]))


@np.errstate(invalid="ignore")  # damage may leave a NaN that numpy signals when it is converted
def samples_from_columns(
    columns: Columns, time_us: NDArray[np.int64], tick_s: float, gyro_unit: GyroUnit | None
) -> tuple[SampleBatch, dict[str, str]]:
    """Samples of the fixed-frequency event, and notes on what was decided about units.

    columns: variable -> (n,) as stored. time_us: (n,) device time in ticks of ``tick_s``.
    A channel without its variables is NaN; segments and host stamps are whoever's reads the file.
    """
    samples = empty_samples(len(time_us), tick_s)
    samples.ticks[:] = time_us
    _fill_attitude(samples, columns)
    _fill(samples.accelerometer, columns, [f"acc.{axis}" for axis in "xyz"], STANDARD_GRAVITY)
    motors = motor_columns_of(columns)
    if not motors.crowd:
        kinds = {columns[name].dtype.itemsize for name in motors.names if name in columns}
        _fill(samples.duty, columns, motors.names, 1 / 255 if kinds == {1} else 1 / FULL_16_BIT)
        _fill(samples.rotor_rev_s, columns, [f"rpm.m{m}" for m in range(1, 5)], 1 / 60)
    for name, unit_v in (("pm.vbat", 1.0), ("pm.vbatMV", 1e-3)):
        if name in columns:
            samples.battery_v[:] = columns[name] * unit_v
    notes: dict[str, str] = {}
    axes = [f"gyro.{axis}" for axis in "xyz"]
    if all(axis in columns for axis in axes):
        gyro = np.column_stack([columns[axis] for axis in axes]).astype(np.float64)
        if gyro_unit is not None:
            unit, why = gyro_unit, "chosen by the caller"
        else:
            unit, why = gyro_unit_of(gyro, samples.attitude, samples.time_s)
        samples.gyro[:] = np.radians(gyro) if unit == "deg/s" else gyro
        notes = {"gyro_unit": unit, "gyro_unit_because": why}
    return samples, notes


def gyro_unit_of(
    gyro: NDArray[np.float64], attitude: NDArray[np.float32], time_s: NDArray[np.float64]
) -> tuple[GyroUnit, str]:
    """The unit of a log's gyro, and how it was decided.

    gyro: (n, 3) as stored. attitude: (n, 3) rad, NaN where there is none. time_s: (n,).

    With an attitude that moves, its rate over the gyro says it (1 or 0.0175). Without, a value
    beyond the sensor's range in rad/s (34.9) can only be deg/s. Else the unit of the
    firmware's ``gyro`` variables is taken: deg/s.
    """
    rate = _body_rate(attitude, time_s)
    if len(rate):
        middle = np.abs(gyro[_RATE_LAG // 2 :][: len(rate)]).max(axis=1)
        speed = np.abs(rate).max(axis=1)
        turning = np.isfinite(speed) & (speed > _TURNING_RAD_S) & (middle > 0)
        if turning.sum() >= 100:
            ratio = float(np.median(speed[turning] / middle[turning]))
            unit: GyroUnit = "rad/s" if ratio > np.sqrt(np.pi / 180) else "deg/s"
            return unit, f"the attitude turns {ratio:.3g} rad/s per unit of gyro"
    limit = np.radians(GYRO_FULL_SCALE_DEG_S)
    peak = float(np.nanmax(np.abs(gyro), initial=0.0))
    if peak > 1.01 * limit:
        return "deg/s", f"the peak of {peak:.0f} is beyond the sensor's range in rad/s"
    return "deg/s", "the unit of the firmware's gyro variables; the data do not say"


def _body_rate(attitude: NDArray[np.float32], time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Body rates in rad/s from attitude, shape (n - lag, 3), the inverse of thesis eq. 3.11."""
    if len(attitude) <= _RATE_LAG:
        return np.empty((0, 3))
    change = (attitude[_RATE_LAG:] - attitude[:-_RATE_LAG]).astype(np.float64)
    change = (change + np.pi) % (2 * np.pi) - np.pi
    elapsed = time_s[_RATE_LAG:] - time_s[:-_RATE_LAG]
    elapsed[elapsed <= 0] = np.nan
    middle = attitude[_RATE_LAG // 2 :][: len(change)]
    return body_rates(middle, change / elapsed[:, None])


def _fill_attitude(samples: SampleBatch, columns: Columns) -> None:
    quaternion = [f"stateEstimate.q{part}" for part in "wxyz"]
    angles = [f"stateEstimate.{name}" for name in ("roll", "pitch", "yaw")]
    whole = all(name in columns for name in quaternion)
    if whole and all(name in columns for name in angles):  # of both, the one that moves
        whole = bool(_changes(columns, quaternion).any() or not _changes(columns, angles).any())
    if whole:
        samples.attitude[:] = attitude_of_quaternion(
            np.column_stack([columns[name] for name in quaternion])
        )
        return
    _fill(samples.attitude, columns, angles, np.pi / 180)
    samples.attitude[:, 1] *= -1  # the firmware's pitch is nose up positive


@np.errstate(over="ignore", invalid="ignore")  # beyond what a channel holds is no value
def _fill(target: NDArray[np.float32], columns: Columns, names: Sequence[str], unit: float) -> None:
    for index, name in enumerate(names):
        if name in columns:
            target[:, index] = columns[name] * unit
