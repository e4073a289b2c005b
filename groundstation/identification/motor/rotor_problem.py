"""The likelihood of four motors in flights: simulated speeds, slopes, weights of the errors.

In flight a motor's speed stays near one value, its load changes slowly (air, brushes, warmth) and
its controller answers. So a motor is described by what such data tell apart, around the mean speed
n_r of all rotors:

    U  armature voltage that holds n_r, mV         = (a1 n_r + a2 n_r^2) / a0
    T  time constant there, s                      = 1 / (a1 + 2 a2 n_r)
    s  share of the load that is quadratic, 0..1   = a2 n_r / (a1 + a2 n_r)

which are positive constants a0, a1, a2 of thesis eq. 3.82 whatever the data say. The error of the
simulated speed is weighted by its own spectrum, piece by piece and free in shape (Whittle), so
that neither slow drift nor vibration passes for a motor's answer. U is each piece's, from its mean
speed, as a battery's and a brush's resistance change; T and s are each rotor's, the lag of the
speed sensors is common.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.sensors import lagged
from groundstation.dynamics.vehicle import MotorConstants
from groundstation.errors import BadInputError
from groundstation.identification.estimate import bounded_step, inverse
from groundstation.identification.likelihood.spectra import Spectrum, fourier, whiten_by_own
from groundstation.identification.motor.problem import (
    COASTING,
    EFFECTS,
    SHARED,
    MotorProblem,
    MotorRun,
)
from groundstation.telemetry.arrays import Array

PIECE_S = 10.0
"""Pieces of flights: their scores scatter as the estimate does, and each may have a U of its own.
Long beside the motors' tenth of a second, short beside the minutes in which a battery and a
motor's warmth change."""
SETTLE_S = 0.5
"""Left out where a simulation starts: five time constants of a slow brushed motor."""
BAND_HZ = (0.5, 20.0)
"""Slower changes are drift, whose spectrum rises too steeply to be weighted by its mean over a
band; a motor's corner lies at 2 Hz and above. Faster ones are vibration that the controller copies
into the PWM, and a sensor that averages and holds is no first-order lag there: with them, T of one
craft differed by a third between calm and fast flights."""
START_T_S, START_LAG_S = 0.06, 0.003
START = {COASTING: 0.5}
"""Where an effect's size begins that has a minimum of its own where it is absent."""
LINEAR_S = 0.05
"""The least s that a motor has: its back EMF, (1 - s) U, is then as high as can be."""
TIME_CONSTANTS_S = (0.002, 2.0)
"""From faster than a row to slower than anything that keeps a craft in the air."""
LONGEST_LAG_S = 0.03
STEPS = 30
SMALL = 0.02
"""Steps end below this share of a standard error."""
PRIOR_S = 0.3
"""Standard deviation of s before any data: that of a number anywhere from 0 to 1."""
MOST_S = 0.95
USUAL_DRIFT = 0.02
"""Standard deviation of ln U where a single piece cannot show it: of brushed motors that flew."""
SHIFT = 1e-6
T, S, OWN = 0, 1, 2
"""Places of ln T and s among a rotor's own parameters, and how many these are."""


@dataclass(slots=True)
class Piece:
    """A rotor in one piece (by number) of a flight (by name).

    measured: (n,) without gaps. begun: ln U by its means. holding: its own ln U, which makes the
    mean speed right. settled: its first row that counts.
    """

    rotor: int
    flight: str
    piece: int
    run: MotorRun
    measured: Array
    begun: float
    settled: int
    holding: float = 0.0


@dataclass(frozen=True, slots=True)
class Holding:
    """ln U of each rotor (r,), medians over ``flights``; standard deviations of one flight's: of
    one rotor against the others (noise), and of all together (drift)."""

    rotors: Array
    noise: float
    drift: float
    flights: int


@dataclass(frozen=True, slots=True)
class Linear:
    """A piece's normal equations. value: its -2 log L. off: what ln U should move by; follows: (k,)
    by how much less for each unit of the others' steps."""

    normal: Array
    gradient: Array
    value: float
    off: float
    follows: Array


class RotorProblem:
    """Parameters: lag, effects, then ln T and s of each rotor; ln U of each piece beside them."""

    def __init__(
        self,
        runs: Sequence[Sequence[MotorRun | None]],
        expected: MotorConstants,
        effects: Sequence[str],
    ) -> None:
        self.effects = tuple(effects)
        means = [np.nanmean(run.rev_s) for four in runs for run in four if run is not None]
        if not means:
            raise BadInputError("motor fit: no rotor speed was recorded by a working sensor")
        self.speed = float(np.mean(means))
        self.expected = shape_of(expected, self.speed)
        self.expected[S + 1] = np.clip(self.expected[S + 1], 0.0, MOST_S)
        self.pieces = [
            part
            for index, four in enumerate(_cut(runs))
            for rotor, run in enumerate(four)
            if run is not None and (part := self._piece(rotor, index, run)) is not None
        ]
        if not self.pieces:
            raise BadInputError("motor fit: the recorded rotor speeds are too short; fly longer")
        self.rotors = sorted({one.rotor for one in self.pieces})
        self.shared = 1 + len(self.effects)
        self.size = self.shared + OWN * len(self.rotors)

    def _piece(self, rotor: int, piece: int, run: MotorRun) -> Piece | None:
        seen = np.flatnonzero(np.isfinite(run.rev_s))
        if len(seen) * run.period_s < 2.0 * SETTLE_S:
            return None
        measured = np.interp(np.arange(len(run.rev_s)), seen, run.rev_s[seen])
        holding = np.log(run.voltage_mv.mean() * self.speed / measured.mean())
        flight, settled = run.name.rpartition(" M")[0], round(SETTLE_S / run.period_s)
        return Piece(rotor, flight, piece, run, measured, float(holding), settled)

    def own(self, rotor: int) -> int:
        """Where a rotor's ln T stands among the parameters."""
        return self.shared + OWN * self.rotors.index(rotor)

    def minimise(self) -> tuple[Array, Array]:
        """The likeliest (theta, normal) from each of the starts."""
        found = [self._descend(share) for share in self._starts()]
        if len(found) == 1:
            return found[0]
        unlikely = []
        for theta, _normal in found:
            self.settle(theta)
            unlikely.append(self.unlikelihood(theta))
        theta, normal = found[int(np.argmin(unlikely))]
        self.settle(theta)
        return theta, normal

    def unlikelihood(self, theta: Array) -> float:
        """-2 log L in the band, given each piece's U, and what was known of s before."""
        parts = [self._linear(theta, one) for one in self.pieces]
        off = theta[[self.own(rotor) + S for rotor in self.rotors]] - self.expected[S + 1]
        return float(sum(one.value for one in parts) + np.mean(off**2) / PRIOR_S**2)

    def _starts(self) -> list[float]:
        """Where s begins: with a threshold, which s moves, there are several minima."""
        expected = float(self.expected[S + 1])
        return [expected, LINEAR_S] if COASTING in self.effects else [expected]

    def _descend(self, share: float) -> tuple[Array, Array]:
        """Gauss-Newton from a share s, with spectra from the last step's errors."""
        theta = np.zeros(self.size)
        theta[0] = START_LAG_S
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        most = np.full(self.size, 0.3)
        low[0], high[0], most[0] = 1e-5, LONGEST_LAG_S, 0.002
        for place, effect in enumerate(self.effects, start=1):
            size = EFFECTS[effect]
            theta[place], most[place] = START.get(effect, size.absent), size.stride
            low[place], high[place] = max(size.bounds[0], 0.0), size.bounds[1]
        for rotor in self.rotors:
            place = self.own(rotor)
            theta[place : place + OWN] = np.log(START_T_S), share
            low[place + T], high[place + T] = np.log(TIME_CONSTANTS_S)
            low[place + S], high[place + S] = 0.0, MOST_S
        for one in self.pieces:
            one.holding = one.begun
        normal = np.eye(self.size)
        for _ in range(STEPS):
            parts = [self._linear(theta, one) for one in self.pieces]
            normal, gradient = self._sum(theta, parts)
            free = np.ones(self.size, np.bool_)
            step = bounded_step(
                normal,
                gradient,
                free,
                np.maximum(low - theta, -most),
                np.minimum(high - theta, most),
            )
            theta = theta + step
            for one, part in zip(self.pieces, parts, strict=True):
                one.holding += float(part.off - part.follows @ step[self._places(one)])
            if np.all(np.abs(step) <= SMALL * np.sqrt(np.diag(inverse(normal)))):
                break
        return theta, normal

    def scores(self, theta: Array) -> Array:
        """Gradients (pieces, p) of the log-likelihood."""
        found = np.zeros((1 + max(one.piece for one in self.pieces), self.size))
        for one in self.pieces:
            found[one.piece, self._places(one)] += self._linear(theta, one).gradient
        return found[np.any(found != 0.0, axis=1)]

    def _places(self, one: Piece) -> NDArray[np.intp]:
        """Places among the parameters of a piece's columns behind ln U."""
        own = self.own(one.rotor)
        return np.array([own + T, own + S, *range(self.shared)], np.intp)

    def _sum(self, theta: Array, parts: Sequence[Linear]) -> tuple[Array, Array]:
        """Normal equations of all pieces, and of what was known of s before."""
        normal, gradient = np.zeros((self.size, self.size)), np.zeros(self.size)
        for one, part in zip(self.pieces, parts, strict=True):
            places = self._places(one)
            normal[np.ix_(places, places)] += part.normal
            gradient[places] += part.gradient
        information = 1.0 / (PRIOR_S**2 * len(self.rotors))  # of the mean's prior, for each
        for rotor in self.rotors:
            place = self.own(rotor) + S
            normal[place, place] += information
            gradient[place] += information * (self.expected[S + 1] - theta[place])
        return normal, gradient

    def _linear(self, theta: Array, one: Piece) -> Linear:
        """A piece around theta: ln T, s, lag, effects; U makes up for their mean."""
        run, lag = one.run, float(theta[0])
        shape = np.array([one.holding, *theta[self.own(one.rotor) :][:OWN]])
        motor = constants_of(shape, self.speed)
        problem = MotorProblem([run], self.effects)
        point = problem.theta([motor.a0, motor.a1, motor.a2])
        point[SHARED : problem.starts] = theta[1 : self.shared]
        speed, slopes = problem.simulate(point, 0)
        columns = np.column_stack([slopes[:, :3] @ self.chain(shape), slopes[:, 4:]])
        both = lagged(np.column_stack([speed, columns]), lag, run.period_s)
        late = -lagged((speed - both[:, 0]) / lag, lag, run.period_s)
        stack = np.vstack([one.measured - both[:, 0], both[:, 2:4].T, late[None], both[:, 4:].T])
        stack, by_holding = stack[:, one.settled :], both[one.settled :, 1]
        follows = stack.mean(axis=1) / by_holding.mean()
        spectra, hz, weight = fourier(stack - follows[:, None] * by_holding, run.period_s)
        whole = Spectrum(0, 0, hz, weight, spectra[0], spectra[1:], np.arange(len(stack) - 1))
        noise = whiten_by_own([whole], [spectra[0]], [np.zeros(len(hz))])[0]
        inside = (hz >= BAND_HZ[0]) & (hz <= BAND_HZ[1])
        power = noise.at(hz)
        counts = np.where(inside, weight / power, 0.0)
        scaled = spectra[1:] * counts
        value = float(weight[inside] @ np.log(power[inside]) + counts @ spectra[0] ** 2)
        return Linear(
            scaled @ spectra[1:].T, scaled @ spectra[0], value, float(follows[0]), follows[1:]
        )

    def chain(self, shape: Array) -> Array:
        """Derivatives (3, 3) of a0, a1, a2 by ln U, ln T, s."""
        found = np.empty((3, 3))
        for i in range(3):
            step = SHIFT * np.eye(3)[i]
            ahead, behind = (constants_of(shape + sign * step, self.speed) for sign in (1, -1))
            for j, name in enumerate(("a0", "a1", "a2")):
                found[j, i] = (getattr(ahead, name) - getattr(behind, name)) / (2 * SHIFT)
        return found

    def settle(self, theta: Array) -> None:
        """Each piece's U given everything else."""
        for _ in range(2):
            for one in self.pieces:
                one.holding += self._linear(theta, one).off

    def holding(self) -> Holding:
        """How U differs between rotors, and between flights (or during the only one)."""
        flights = list(dict.fromkeys(one.flight for one in self.pieces))
        several = len(flights) > 1
        count = len(flights) if several else 1 + max(one.piece for one in self.pieces)
        sums, weights = np.zeros((count, len(self.rotors))), np.zeros((count, len(self.rotors)))
        for one in self.pieces:
            place = (
                flights.index(one.flight) if several else one.piece,
                self.rotors.index(one.rotor),
            )
            sums[place] += one.holding
            weights[place] += 1.0
        rows = weights.any(axis=1)
        with np.errstate(invalid="ignore"):
            table = (sums / weights)[rows]
        flight = np.nanmean(table - np.nanmedian(table, axis=0), axis=1)
        rotor = np.nanmedian(table - flight[:, None], axis=0)
        left = table - flight[:, None] - rotor
        freedom = int(np.isfinite(left).sum()) - len(flight) - len(rotor) + 1
        noise = np.sqrt(np.nansum(left**2) / freedom) if freedom > 0 else USUAL_DRIFT
        drift = flight.std(ddof=1) if len(flight) > 1 else USUAL_DRIFT
        return Holding(
            rotor + float(np.median(flight)), float(noise), float(drift), count if several else 1
        )


def constants_of(shape: Array, speed_rev_s: float) -> MotorConstants:
    """a0, a1, a2 of (ln U, ln T, s) at a speed."""
    holding, slow, share = np.exp(shape[0]), np.exp(shape[1]), float(shape[2])
    load = 1.0 / (slow * (1.0 + share))
    return MotorConstants(
        a0=float(load * speed_rev_s / holding),
        a1=float((1.0 - share) * load),
        a2=float(share * load / speed_rev_s),
    )


def shape_of(motor: MotorConstants, speed_rev_s: float) -> Array:
    """(ln U, ln T, s) of a motor at a speed, (3,)."""
    linear, quadratic = motor.a1, motor.a2 * speed_rev_s
    return np.array(
        [
            np.log((linear + quadratic) * speed_rev_s / motor.a0),
            -np.log(linear + 2.0 * quadratic),
            quadratic / (linear + quadratic),
        ]
    )


def _cut(runs: Sequence[Sequence[MotorRun | None]]) -> list[list[MotorRun | None]]:
    """Pieces of flights, of ``PIECE_S`` or a little more."""
    pieces = []
    for four in runs:
        one = next((run for run in four if run is not None), None)
        if one is None:
            continue
        count = max(1, int(len(one.rev_s) * one.period_s / PIECE_S))
        edges = np.linspace(0, len(one.rev_s), count + 1).astype(int)
        pieces += [
            [None if run is None else _rows(run, a, b) for run in four] for a, b in pairwise(edges)
        ]
    return pieces


def _rows(run: MotorRun, first: int, last: int) -> MotorRun:
    parts = (
        getattr(run, name)[first:last] for name in ("voltage_mv", "rev_s", "age_s", "jitter_s")
    )
    return MotorRun(run.name, run.period_s, *parts)
