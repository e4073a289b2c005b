"""What each parameter of the body model adds to the measured angular acceleration.

The rates are measured, so the body is written row by row: the step of a gyro axis over one
period, divided by it, is a mean angular acceleration; c0, c1, c2 multiply the mixer's mean u'
over the same time (thesis eq. 7.12-7.14 and 7.20-7.22). The named effects that may be fitted
along are regressors of the same kind, but for the delay, which shifts them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.mixer import MIXERS
from groundstation.dynamics.motor import REVOLUTION
from groundstation.dynamics.vehicle import MotorConstants, Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.runs import Run
from groundstation.identification.torque import RotorSquares, rotor_squares

Array = NDArray[np.float64]

SPIN = np.array([-1.0, 1.0, -1.0, 1.0])
TAKE_OFF_S, LANDING_S = 1.5, 1.0
"""Left out where the motors start or stop: the ground carries part of the torque."""
LEAST_S = 4.0
FIT_WITH = (
    "dead_time",
    "inertia_coupling",
    "rotor_gyroscopic_torque",
    "rotor_acceleration_torque",
)
"""Effects that can be fitted jointly with the base parameters."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Consecutive airborne rows of a run, with the rotors behind them.

    first: its first row in ``run``. squares, run: of the whole run, so that interpolation and
    motor speeds know what came before.
    """

    run: Run
    squares: RotorSquares
    first: int
    last: int

    @property
    def rows(self) -> slice:
        return slice(self.first, self.last)

    def __len__(self) -> int:
        return self.last - self.first


def stretches_of(
    runs: Sequence[Run], motor: MotorConstants, measured: bool = False
) -> list[Stretch]:
    """The airborne parts of runs, at least 4 s each.

    Motors are simulated over whole runs. A run that starts in the air loses its first half
    second, over which the motors forget the speed they were assumed to have.

    Raises BadInputError where nothing is left, or where the gyro is missing.
    """
    found = []
    for run in runs:
        if not np.isfinite(run.gyro).all():
            raise BadInputError(f"{run.name}: the gyro is missing in some rows")
        squares = rotor_squares(run, motor, measured)
        turning = (run.duty > 0.1).all(axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], turning.astype(np.int8), [0]])))
        for first, last in edges.reshape(-1, 2).tolist():
            first += round((TAKE_OFF_S if first > 0 else 0.5) / run.period_s)
            last -= round(LANDING_S / run.period_s) if last < len(run) else 0
            if (last - first) * run.period_s >= LEAST_S:
                found.append(Stretch(run, squares, first, last))
    if not found:
        names = ", ".join(sorted({run.name for run in runs}))
        raise BadInputError(
            f"{names}: no {LEAST_S:.0f} s of uninterrupted flight after take-off; record longer"
        )
    return found


def split(stretches: Sequence[Stretch], share: float = 1 / 3) -> tuple[list[Stretch], ...]:
    """(to fit on, to validate on): the last ``share`` of all rows."""
    left = round(sum(len(s) for s in stretches) * (1 - share))
    fit, held = [], []
    for one in stretches:
        middle = one.first + max(min(left, len(one)), 0)
        left -= len(one)
        if middle > one.first:
            fit.append(Stretch(one.run, one.squares, one.first, middle))
        if middle < one.last:
            held.append(Stretch(one.run, one.squares, middle, one.last))
    return fit, held


@dataclass(frozen=True, slots=True)
class Terms:
    """One stretch as a linear model, per axis.

    acceleration: (n, 3) measured, rad/s^2. base: (n, 3) u' behind it. slope: (n, 3) derivative of
    ``base`` by the delay. effects: name -> (n, 3), per unit of the effect's parameter.
    """

    acceleration: Array
    base: Array
    slope: Array
    effects: dict[str, Array]


def terms_of(stretch: Stretch, vehicle: Vehicle, delay_s: float, names: Sequence[str]) -> Terms:
    """The regressors of a stretch when all outputs lag by ``delay_s``."""
    run, rows = stretch.run, stretch.rows
    period = run.period_s
    mixer = MIXERS[vehicle.configuration]
    torque = stretch.squares.end @ mixer.T
    impulse = np.cumsum(stretch.squares.square @ mixer.T, axis=0) * period
    at = np.arange(stretch.first - 1, stretch.last, dtype=np.float64) - delay_s / period
    base = np.diff(_hermite(impulse, torque * period, at), axis=0) / period
    slope = -np.diff(_linear(torque, at), axis=0) / period
    acceleration = np.diff(run.gyro, axis=0, prepend=run.gyro[:1])[rows] / period
    effects: dict[str, Array] = {}
    ixx, iyy, izz = vehicle.inertia_kg_m2
    # Rates that multiply something are those of the rows before: the present row's noise is in
    # the acceleration too, and a product with it would look like damping.
    p, q, r = run.gyro[stretch.first - 1 : stretch.last - 1].T
    omega = np.asarray(REVOLUTION * np.sqrt(stretch.squares.end) @ SPIN, np.float64)
    zero = np.zeros(len(stretch))
    for name in names:
        if name == "inertia_coupling":
            effects[name] = np.column_stack(
                [(iyy - izz) / ixx * q * r, (izz - ixx) / iyy * p * r, (ixx - iyy) / izz * p * q]
            )
        elif name == "rotor_gyroscopic_torque":
            momentum = _linear(omega[:, None], at[1:] - 0.5)[:, 0]
            effects[name] = np.column_stack([q * momentum / ixx, -p * momentum / iyy, zero])
        elif name == "rotor_acceleration_torque":
            gained = np.diff(_linear(omega[:, None], at), axis=0)[:, 0] / period
            effects[name] = np.column_stack([zero, zero, gained / izz])
    return Terms(acceleration, base, slope, effects)


def require_known(names: Sequence[str]) -> None:
    """Raises BadInputError for an effect that cannot be fitted along."""
    unknown = [name for name in names if name not in FIT_WITH]
    if unknown:
        raise BadInputError(
            f"--with {', '.join(unknown)}: the body fit knows {', '.join(FIT_WITH)}"
        )


def _linear(values: Array, at: Array) -> Array:
    """Values between rows, held beyond the ends; values (n, m), at (k,) to (k, m)."""
    place = np.clip(at, 0, len(values) - 1.0)
    index = np.minimum(place.astype(np.int64), len(values) - 2)
    share = (place - index)[:, None]
    return np.asarray(values[index] + share * (values[index + 1] - values[index]))


def _hermite(values: Array, slopes: Array, at: Array) -> Array:
    """Cubic interpolation of an integral with known integrand (``slopes`` per row)."""
    place = np.clip(at, 0, len(values) - 1.0)
    index = np.minimum(place.astype(np.int64), len(values) - 2)
    t = (place - index)[:, None]
    one, other = values[index], values[index + 1]
    rise, end = slopes[index], slopes[index + 1]
    return np.asarray(
        one * (1 + 2 * t) * (1 - t) ** 2
        + rise * t * (1 - t) ** 2
        + other * t**2 * (3 - 2 * t)
        + end * t**2 * (t - 1)
    )
