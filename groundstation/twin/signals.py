"""What a craft might do that its model does not: one signal for each regime and axis.

A signal is what drives a kind of disturbance (the rate that would be damped, the acceleration
of the rotors, the velocity through the air), and where it would act: as a torque, as a force
that the accelerometer feels, as an error of the gyro or of the reported angles. None of them
knows the size of anything; the regimes are those of ``comparison.regimes``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np

from groundstation.comparison.gap import CHANNELS
from groundstation.dynamics.effect import SPIN
from groundstation.dynamics.model import Model
from groundstation.dynamics.registry import DELAY
from groundstation.dynamics.rotations import matrix_of_quaternion
from groundstation.dynamics.simulation import QUATERNION, RATE, REVOLUTION, VELOCITY
from groundstation.dynamics.vehicle import MIXERS, Configuration
from groundstation.errors import BadInputError
from groundstation.identification.runs import (
    FASTEST_HZ,
    LONGEST_GAP_S,
    SupplyAnswer,
    at_the_rows_voltage,
    both_settings,
)
from groundstation.prediction.prediction import Observed
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S, STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch, filled

# Samples of a live stream on an even grid, as many as the twin still needs.


SLOWEST_HZ = 200.0
"""Slower telemetry has too few rows in half a second to be judged."""
RHYTHM_ROWS = 50
"""Samples from which the period is told."""
WIDTH = 18
DUTY, SUPPLY, STEP = slice(0, 4), 4, slice(14, 18)
INPUTS = (0, 1, 2, 3, 4, 14, 15, 16, 17)
"""Columns that are known between their neighbours: duty, supply and the step of the duty."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Consecutive rows (``prediction.prediction.Flown``). Inputs of lost rows are on the line
    between their neighbours; what a lost row would have measured is NaN.

    duty, duty_step: (n, 4), supply_v: (n,), gyro, accelerometer, attitude: (n, 3), SI.
    """

    period_s: float
    duty: Array
    supply_v: Array
    gyro: Array
    accelerometer: Array
    attitude: Array
    duty_step: Array

    @property
    def settings(self) -> Array:
        """As of ``identification.runs.Run``."""
        return both_settings(self.duty, self.duty_step)

    def since(self, row: int) -> Piece:
        """The same from a row on."""
        columns = [getattr(self, one.name) for one in fields(self)[1:]]
        return Piece(self.period_s, *(column[row:] for column in columns))


class Rows:
    """One uninterrupted stretch of a stream, numbered from its first row.

    period_s: of a row. count: rows so far. Only rows from ``first`` on are kept.
    """

    def __init__(self, period_s: float, tick_s: float) -> None:
        self.period_s = period_s
        self.first = self.count = 0
        self._tick_s = tick_s
        self._answer = SupplyAnswer()
        self._table = np.empty((0, WIDTH))
        self._time_s = np.empty(0)
        self._host_ns = np.empty(0, np.int64)

    def append(self, samples: SampleBatch) -> None:
        """Samples without a break (``unbroken``) between them or before them."""
        time_s = samples.ticks * self._tick_s
        before = self._time_s[-1] if len(self._time_s) else time_s[0] - self.period_s
        steps = np.maximum(np.rint(np.diff(time_s, prepend=before) / self.period_s), 1.0)
        place = np.cumsum(steps).astype(np.int64) - 1
        rows = int(place[-1]) + 1
        new = np.full((rows, WIDTH), np.nan)
        measured = samples.duty, samples.battery_v, samples.gyro, samples.accelerometer
        new[place] = np.column_stack([*measured, samples.attitude, samples.duty_step])
        inputs = new[:, DUTY], new[:, STEP], new[:, SUPPLY]
        new[:, DUTY], new[:, STEP] = at_the_rows_voltage(*inputs, self._answer.learn(*inputs))
        # With the row before, so that what is lost first lies between two neighbours.
        start = max(len(self._table) - 1, 0)
        self._table = np.concatenate([self._table, new])
        self._table[start:, INPUTS] = filled(self._table[start:, INPUTS])
        self._time_s = np.concatenate([self._time_s, np.interp(np.arange(rows), place, time_s)])
        hosts = np.interp(np.arange(rows), place, samples.host_time_ns - samples.host_time_ns[0])
        self._host_ns = np.concatenate(
            [self._host_ns, samples.host_time_ns[0] + hosts.astype(np.int64)]
        )
        self.count += rows

    def forget(self, before: int) -> None:
        """Rows before this one are not needed any more."""
        drop = max(before - self.first, 0)
        self._table = self._table[drop:]
        self._time_s, self._host_ns = self._time_s[drop:], self._host_ns[drop:]
        self.first += drop

    def piece(self, first: int, last: int) -> Piece:
        """Rows ``first`` to ``last`` (exclusive)."""
        part = self._table[first - self.first : last - self.first]
        columns = DUTY, SUPPLY, slice(5, 8), slice(8, 11), slice(11, 14), STEP
        return Piece(self.period_s, *(np.ascontiguousarray(part[:, one]) for one in columns))

    def time_s(self, first: int, last: int) -> Array:
        """Device time of rows."""
        return self._time_s[first - self.first : last - self.first]

    def host_ns(self, row: int) -> int:
        """Unix time at which a row arrived."""
        return int(self._host_ns[row - self.first])


def period_of(samples: SampleBatch) -> float:
    """Seconds from row to row. Raises BadInputError for a rate that is not inertial telemetry's."""
    usual = float(np.median(np.diff(samples.time_s)))
    if abs(usual / SAMPLE_PERIOD_S - 1.0) < 2e-3:  # the tick is coarser than the crystal
        return SAMPLE_PERIOD_S
    if not 1 / FASTEST_HZ <= usual <= 1 / SLOWEST_HZ:
        raise BadInputError(
            f"a sample every {usual * 1e3:.3g} ms; the twin needs"
            f" {SLOWEST_HZ:.0f} to {FASTEST_HZ:.0f} samples a second"
        )
    return usual


def unbroken(
    samples: SampleBatch, before: SampleBatch | None
) -> Iterator[tuple[bool, SampleBatch]]:
    """(whether it begins anew, samples) for each part without a restart or a long silence.

    before: the last sample of what came before.
    """
    joined = samples if before is None else SampleBatch.concatenate([before, samples])
    steps = np.diff(joined.time_s)
    broken = (steps > LONGEST_GAP_S) | (steps <= 0) | (np.diff(joined.segment) != 0)
    offset = 0 if before is None else 1
    cuts = np.flatnonzero(broken) + 1 - offset
    edges = [0, *(int(cut) for cut in cuts if cut > 0), len(samples)]
    new = before is None or bool(len(cuts) and cuts[0] == 0)
    for first, last in pairwise(edges):
        yield new, samples[first:last]
        new = True


BRAKING_S = 0.05
"""A small motor with its propeller settles within about this time."""
NEAR_M = 0.1
"""Height over which the ground's influence fades."""
WHOLE = "whole flight"
TILTING, YAWING = "roll or pitch torque", "after yaw commands"
TURNING, SPINNING = "high roll or pitch rate", "high yaw rate"
SEVERAL = "turning about several axes"
ROTORS, BRAKING = "rotor acceleration", "rotors slowing down"


@dataclass(frozen=True, slots=True)
class Place:
    """Where a disturbance shows: a channel (``CHANNELS``) in a regime."""

    channel: str
    regime: str


@dataclass(frozen=True, slots=True)
class Kind:
    """One signal. acts: ``torque`` (rad/s^2), ``force`` (m/s^2, felt by the accelerometer),
    ``gyro`` (rad/s) or ``angle`` (rad/s, of the report). axis: 0, 1, 2. drive: the column of
    ``drives`` behind it."""

    place: Place
    acts: str
    axis: int
    drive: str


_SHOWN: tuple[tuple[Any, ...], ...] = (
    ("torque", 0, WHOLE, "thrust"),
    ("torque", 0, TILTING, "roll torque", "roll change", "pitch torque"),
    ("torque", 0, YAWING, "yaw torque"),
    ("torque", 0, TURNING, "p"),
    ("torque", 0, SEVERAL, "qr"),
    ("torque", 0, "translation", "v"),
    ("torque", 0, YAWING, "pitch momentum"),
    ("torque", 0, BRAKING, "roll braking"),
    ("torque", 1, WHOLE, "thrust"),
    ("torque", 1, TILTING, "pitch torque", "pitch change", "roll torque"),
    ("torque", 1, YAWING, "yaw torque"),
    ("torque", 1, TURNING, "q"),
    ("torque", 1, SEVERAL, "pr"),
    ("torque", 1, "translation", "u"),
    ("torque", 1, YAWING, "roll momentum"),
    ("torque", 1, BRAKING, "pitch braking"),
    ("torque", 2, WHOLE, "thrust"),
    ("torque", 2, YAWING, "yaw torque"),
    ("torque", 2, TILTING, "roll torque", "pitch torque"),
    ("torque", 2, SPINNING, "r"),
    ("torque", 2, SEVERAL, "pq"),
    ("torque", 2, ROTORS, "spin change", "yaw change"),
    ("torque", 2, BRAKING, "yaw braking"),
    ("force", 0, WHOLE, "one"),
    ("force", 0, "translation", "u"),
    ("force", 0, TILTING, "pitch torque"),
    ("force", 0, YAWING, "yaw torque"),
    ("force", 0, "high thrust", "more thrust"),
    ("force", 0, SPINNING, "rr"),
    ("force", 1, WHOLE, "one"),
    ("force", 1, "translation", "v"),
    ("force", 1, TILTING, "roll torque"),
    ("force", 1, YAWING, "yaw torque"),
    ("force", 1, "high thrust", "more thrust"),
    ("force", 1, SPINNING, "rr"),
    ("force", 2, WHOLE, "one"),
    ("force", 2, "high thrust", "more thrust"),
    ("force", 2, "climb", "w"),
    ("force", 2, "thrust change", "thrust change"),
    ("force", 2, BRAKING, "braking"),
    ("force", 2, "near ground", "near"),
    ("force", 2, TILTING, "roll torque", "pitch torque"),
    ("force", 2, TURNING, "pp+qq"),
    ("gyro", 0, TILTING, "roll torque"),
    ("gyro", 1, TILTING, "pitch torque"),
    ("gyro", 2, YAWING, "yaw torque"),
    ("angle", 0, WHOLE, "one"),
    ("angle", 0, "tilted", "tilt x"),
    ("angle", 1, WHOLE, "one"),
    ("angle", 1, "tilted", "tilt y"),
    ("angle", 2, WHOLE, "one"),
)
"""How a signal acts, its axis, the regime in which it shows, and what drives it."""
_FIRST = {"torque": 0, "force": 3, "gyro": 0, "angle": 6}
KINDS = tuple(
    Kind(Place(CHANNELS[_FIRST[acts] + axis], regime), acts, axis, drive)
    for acts, axis, regime, *drives in _SHOWN
    for drive in drives
)
"""Every signal that is looked for."""

PHASE = 1.0 / np.sqrt(12.0)
"""Standard deviation, in rows, of a sensor's clock that runs beside the control loop's."""
UNTIMED_ROWS = 0.05
LAG_S, GAIN = 5e-5, 0.005
"""Doubt that stays about a gyro's lag and a torque's or the thrust's gain: what a fit leaves, and
what an observer that is not tuned to the last per cent makes of feedback."""
GYRO_STEP = math.radians(1 / 16.384)
ACCELEROMETER_STEP = STANDARD_GRAVITY / 4096
"""A register's step: a constant within it is no disagreement."""
SHARED = tuple(
    number
    for number, kind in enumerate(KINDS)
    if (kind.drive.endswith("change") and kind.drive != "spin change")
    or kind.drive == "one"
    or kind.acts == "gyro"
    or (kind.acts, kind.drive) == ("force", "more thrust")
    or (kind.acts == "torque" and kind.drive == f"{AXES[kind.axis]} torque")
)
"""Signals of which a good model may still show a little, and that others must not borrow from."""


NEGLIGIBLE = {
    ("torque", "thrust"): 0.005,  # rad/s^2 per m/s^2: 2 um beside the centre
    ("torque", "pqr"): 0.02,  # 1/s
    ("torque", "products"): 0.03,
    ("torque", "uv"): 0.1,  # rad/s^2 per m/s
    ("torque", "torque"): 0.005,
    ("torque", "momentum"): 2e-4,  # rotor's inertia over the craft's
    ("torque", "spin change"): 5e-5,
    ("torque", "braking"): 2e-6,
    ("force", "uvw"): 0.01,  # m/s^2 per m/s
    ("force", "torque"): 1e-4,  # m
    ("force", "products"): 2e-4,  # m
    ("force", "braking"): 1e-6,
    ("force", "near"): 1e-3,
    ("angle", "tilt"): 0.01,  # 1/s; the firmware's filter pulls with 0.4
}
"""Standard deviation of what no test need tell, by how a signal acts and what drives it: about a
tenth of the smallest that the list of effects calls one."""


def allowances(model: Model, period_s: float) -> Array:
    """Standard deviation (len(KINDS),) of what a good model leaves of each signal.

    A model with a dead time knows its mean only: a sensor's clock that runs beside the loop's
    makes it up to half a row more or less, anew at each start.
    """
    timed = any(term.name == DELAY.partition(".")[0] for term in model.effects)
    delay_s = (PHASE if timed else UNTIMED_ROWS) * period_s
    return np.array([_allowance(number, delay_s) for number in range(len(KINDS))])


def _allowance(number: int, delay_s: float) -> float:
    kind = KINDS[number]
    if number in SHARED:
        if kind.drive == "one":
            return ACCELEROMETER_STEP if kind.acts == "force" else GYRO_STEP
        if kind.acts == "gyro":
            return math.hypot(LAG_S, delay_s)
        return delay_s if kind.drive.endswith("change") else GAIN
    last = kind.drive.split()[-1]
    single = {"p": "pqr", "q": "pqr", "r": "pqr", "u": "uv", "v": "uv", "w": "uvw"}
    name = {"x": "tilt", "y": "tilt"}.get(last, single.get(kind.drive, last))
    if kind.acts == "force" and name == "uv":
        name = "uvw"
    for each in (kind.drive, name, "products"):
        if (kind.acts, each) in NEGLIGIBLE:
            return NEGLIGIBLE[kind.acts, each]
    raise KeyError(kind)


def drives(
    seen: Observed, configuration: Configuration, since_lift_s: Array, memory: Memory
) -> Array:
    """What drives the signals on the rows of a stretch, (n - 1, len(KINDS)): row k acts from row k
    to k + 1.

    since_lift_s: (n,) time since a take-off. memory: what is carried from part to part.
    """
    n, period = len(seen.states), seen.drive.period_s
    middle = seen.drive.push[1 : 2 * n - 2 : 2]
    thrust, torque = middle[:, 0], middle[:, 2:]
    change = np.diff(seen.drive.push[0 : 2 * n - 1 : 2], axis=0) / period
    speed = seen.drive.speed[0 : 2 * n - 1 : 2]
    slope = np.diff(speed, axis=0) / period
    slowed = memory.leak(np.minimum(slope, 0.0), period) * speed[1:]
    mixed = slowed @ MIXERS[configuration].T
    p, q, r = seen.states[:-1, RATE].T
    turn = matrix_of_quaternion(seen.states[:-1, QUATERNION])
    velocity = seen.states[:-1, VELOCITY]
    u, v, w = np.einsum("nij,ni->nj", turn, velocity).T
    height = memory.climb(velocity[:, 2], since_lift_s[:-1], period)
    spin = REVOLUTION * speed[:-1] @ SPIN
    fading = np.exp(-np.maximum(height, 0.0) / NEAR_M)
    made = {
        "one": np.ones(n - 1),
        "thrust": thrust,
        "more thrust": thrust - STANDARD_GRAVITY,
        "thrust change": change[:, 0],
        **{f"{axis} torque": torque[:, k] for k, axis in enumerate(AXES)},
        **{f"{axis} change": change[:, 2 + k] for k, axis in enumerate(AXES)},
        **{f"{axis} braking": mixed[:, k] for k, axis in enumerate(AXES)},
        "braking": slowed.sum(axis=1),
        **{"p": p, "q": q, "r": r, "qr": q * r, "pr": p * r, "pq": p * q},
        **{"rr": r * r, "pp+qq": p * p + q * q, "u": u, "v": v, "w": w},
        "pitch momentum": q * spin,
        "roll momentum": p * spin,
        "spin change": np.diff(speed @ SPIN) * REVOLUTION / period,
        "tilt x": turn[:, 2, 1],
        "tilt y": -turn[:, 2, 0],
        "near": np.where(np.isfinite(height), thrust * fading, 0.0),
    }
    return np.column_stack([made[kind.drive] for kind in KINDS])


class Memory:
    """What drives of one part need of the part before."""

    def __init__(self) -> None:
        self._leaked = np.zeros((1, 4))
        self._height = 0.0

    def leak(self, values: Array, period_s: float) -> Array:
        """Leaky integral of (n, 4)."""
        from scipy.signal import lfilter

        keep = float(np.exp(-period_s / BRAKING_S))
        out, self._leaked = lfilter([period_s], [1.0, -keep], values, axis=0, zi=self._leaked)
        return np.asarray(out)

    def climb(self, speed: Array, since_lift_s: Array, period_s: float) -> Array:
        """Height (n,) for some seconds after a take-off, infinite elsewhere."""
        known = since_lift_s < LOW_S
        gained = np.where(known, speed, 0.0) * period_s
        start = np.flatnonzero(np.diff(since_lift_s, prepend=since_lift_s[0]) < 0)
        if len(start):
            self._height = -float(gained[: start[-1]].sum())
        height = self._height + np.cumsum(gained)
        self._height = float(height[-1])
        return np.where(known, height, np.inf)


LOW_S = 4.0
"""Height is reckoned for so long after a take-off."""


def entries(period_s: float, lean: bool, errors: int) -> tuple[Array, Array]:
    """(what one unit of each signal adds to the observer's error over a row (e, s), and to what
    is measured at its end (9, s)).

    lean: the model has the firmware's attitude filter, which goes by the gyro alone. errors: how
    many numbers the observer's error has.
    """
    enters, seen = np.zeros((errors, len(KINDS))), np.zeros((9, len(KINDS)))
    for s, kind in enumerate(KINDS):
        if kind.acts == "torque":
            enters[3 + kind.axis, s] = period_s
            enters[kind.axis, s] = 0.5 * period_s**2
        elif kind.acts == "force":
            seen[3 + kind.axis, s] = 1.0
        elif kind.acts == "gyro":
            seen[kind.axis, s] = 1.0
        elif lean:
            seen[6 + kind.axis, s] = 2.0 * period_s
        else:
            enters[kind.axis, s] = period_s
    return enters, seen
