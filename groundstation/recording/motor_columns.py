"""Which column is a motor's, and whether it is duty or thrust."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import attitude_of_quaternion, body_rates
from groundstation.recording.session import Findings
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import FULL_16_BIT, STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch, empty_samples

# Whether a table's motors are a quadrotor's: no more than four of them move.


ROTORS = 4
MOTOR = re.compile(r"mot|pwm|duty|out|control|esc|throttle|rotor|rpm|^m_?\d|^u_?\d", re.IGNORECASE)
"""Names of motors; of an array of anything, each number is something else."""
MOVES = 0.2
"""A motor moves where its column changes so often against the usual of those that are mapped: an
output that idles, or a servo that is set now and then, does not."""


def siblings(columns: Sequence[str], names: Collection[str]) -> list[str]:
    """Columns that are named as the motors' columns are, with another number: ``motor[4]`` beside
    ``motor[0]`` to ``motor[3]``."""
    patterns = set()
    for column in columns:
        numbered = re.fullmatch(r"(.*?)(\d+)(\D*)", column)
        if numbered and MOTOR.search(column.rpartition(".")[2]):
            patterns.add(rf"{re.escape(numbered[1])}\d{{1,2}}{re.escape(numbered[3])}")
    spelled = re.compile("|".join(sorted(patterns)) or r"(?!)")
    return sorted(name for name in set(names) - set(columns) if spelled.fullmatch(name))


def changes(values: NDArray[np.float64]) -> NDArray[np.intp]:
    """How often each column (n, k) takes a new value."""
    known = np.isfinite(values[1:]) & np.isfinite(values[:-1])
    return np.count_nonzero((values[1:] != values[:-1]) & known, axis=0)


def too_many(mapped: NDArray[np.intp], others: NDArray[np.intp], names: Sequence[str]) -> str:
    """Why these are no quadrotor's motors, or empty. mapped, others: how often the mapped ones and
    their siblings change; names: of the siblings."""
    usual = float(np.median(mapped)) if len(mapped) else 0.0
    if usual == 0.0:
        return ""
    also = [name for name, count in zip(names, others, strict=True) if count > MOVES * usual]
    moving = int(np.count_nonzero(mapped > MOVES * usual)) + len(also)
    if moving <= ROTORS:
        return ""
    listed = ", ".join(also[:4])
    return (
        f"not of a quadrotor ({moving} motors move, {listed} among them): its motors are left out"
    )


# From the firmware's log variables to samples: names, units, signs.
#
# | variables | meaning |
# |---|---|
# | gyro.x y z | body rates, body FLU; deg/s in the firmware, see ``gyro_unit_of`` |
# | acc.x y z | specific force in g |
# | motor.m1..m4, pwm.m1_pwm..m4_pwm | PWM of full scale 65535 (255 where stored in one byte) |
# | rpm.m1..m4 | measured rotor speed, rev/min |
# | pm.vbatMV, pm.vbat | battery, mV or V |
# | stateEstimate.qw qx qy qz | attitude, body FLU in ENU |
# | stateEstimate.roll pitch yaw | attitude in deg where there is no quaternion; pitch nose up |


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


# Whether ``motor.m1..m4`` of a Crazyflie 2.x are its motors' duty, or thrust that was asked for.
#
# Firmware before November 2022 logs them before it compensates for the battery (crazyflie-
# firmware #77): thrust of 60 g at full scale, which becomes V = 0.088 t - 0.0006239 t^2 and then
# duty = V over the battery's voltage. ``pwm.m1_pwm`` is the duty in every release. Of the duty,
# thrust changes with duty times voltage; of the command, with the command alone: a flight in
# which the voltage changes enough beside the duty tells them apart.


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


def settle_duty(samples: SampleBatch, found: Findings) -> None:
    """Decide of samples that have ``motor.m1..m4`` in the duty's place, and make it the duty."""
    if not np.isfinite(samples.duty).any():
        return
    said = told_by_flight(samples)
    if said == "command":
        command, battery_v = samples.duty.astype(np.float64), samples.battery_v.astype(np.float64)
        samples.duty[:] = duty_of_command(command, battery_v)
        found.notes.append(MADE)
    elif said != "duty":
        found.unclear.setdefault("duty", NOT_KNOWN)


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
