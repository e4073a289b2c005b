"""The least-squares problem of a search: flights, prior knowledge, noise, and joint fits."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.dynamics.effect import CANDIDATES, Key
from groundstation.dynamics.model import EffectTerm, Estimate, Model, model_vehicle
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import Vehicle
from groundstation.identification.estimate import as_met, bounded_step, inverse
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.evaluation import ACCELEROMETER, rate_errors
from groundstation.identification.likelihood.motion import (
    BODY_KEYS,
    KEYS,
    LAG_DOUBT_S,
    MOTOR_KEYS,
    SENSOR_LAG,
    TIMING,
    Frame,
    Point,
    Prior,
    Variant,
    fitted_along,
    prior_of,
    sensor_lag,
    trim_of,
    value,
)
from groundstation.identification.likelihood.spectra import (
    Linear,
    Noise,
    Quadratic,
    Spectrum,
    leverage,
    linearise,
    quadratic,
    settled,
    trimmed,
    whiten_by_own,
)
from groundstation.telemetry.arrays import Array

# The firmware's own filters behind gyro and accelerometer: which of them flights show.


ON_BOARD = {name: effect for name, effect in EFFECTS.items() if effect.on_board}
SHOWS_S = 1.0 / 240.0
"""Rows further apart hold mostly what the slowest of them (30 Hz) has let pass, and not its lag."""


def filters_of(vehicle: Vehicle, flights: Sequence[Flight]) -> dict[str, float]:
    """Corner in Hz of each on-board filter that these flights show, by its effect's name.

    Where rotor speeds were recorded not the accelerometer's: what is fast in them is mostly noise,
    and along z, behind the filter, it would say how late everything is. On real flights a search
    then lost what it had named (payload: gap 4.5, with both filters 8.4).
    """
    if not _fast(flights):
        return {}
    felt = all(flight.has_accelerometer for flight in flights) and not _speeds_recorded(flights)
    return {
        name: corner
        for name, effect in ON_BOARD.items()
        if (corner := getattr(vehicle, effect.on_board)) > 0.0
        and (felt or "accelerometer" not in effect.needs)
    }


def in_plane_hz(vehicle: Vehicle, flights: Sequence[Flight], known: Collection[str]) -> float:
    """Corner of the filter that forces in the rotors' plane have passed, which no effect holds.

    known: effects of the model.
    """
    held = any("accelerometer" in EFFECTS[name].needs for name in known if name in ON_BOARD)
    shown = _fast(flights) and _speeds_recorded(flights) and not held
    return vehicle.accelerometer_filter_hz if shown else 0.0


def _fast(flights: Sequence[Flight]) -> bool:
    return all(flight.period_s < SHOWS_S for flight in flights)


def _speeds_recorded(flights: Sequence[Flight]) -> bool:
    return any(np.isfinite(flight.run.rotor_rev_s).any() for flight in flights)


def filter_terms(corners: dict[str, float]) -> list[EffectTerm]:
    """The filters as models hold them: the firmware's numbers, without an error."""
    return [
        EffectTerm(name, {one.name: Estimate(corner, None, one.unit)})
        for name, corner in corners.items()
        for one in EFFECTS[name].sizes
    ]


BASE_KEYS = (*BODY_KEYS, *MOTOR_KEYS, TIMING)
NOISE_ROUNDS, LATER_NOISE_ROUNDS = 3, 2
SHAPE_HZ, SHAPE_FREEDOM = 3.0, 100.0
"""Width of the bands in which flights have noise of their own, and the degrees of freedom that
each band needs at least."""
STEPS, SETTLED = 6, 0.05
"""Gauss-Newton steps at most, and the drop of -2 log L that is not worth another."""
TIMING_BOUNDS = (-8.0, 2.0)
"""Angles of an estimator elsewhere (motion capture) come some periods late."""
SHARED = 1e-3
"""Share of a usual size to which two effects agree on a number of the craft that both have."""
GYRO_COUNT_RAD_S = math.radians(2000.0) / 32768.0
"""Of the gyro's lasting offset between flights: the firmware takes it off in whole counts when it
starts, and the sensor warms up after that."""
RATE_GAINS = (0.03, 0.1, 0.25, 0.5, 0.8)


@dataclass(frozen=True, slots=True)
class Fit:
    """A joint fit: where it ended, -2 log L there with the prior's part, covariance (p, p)."""

    point: Point
    keys: tuple[str, ...]
    cost: float
    covariance: Array

    def stderr(self) -> dict[str, float]:
        """Standard errors by key."""
        return dict(zip(self.keys, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


class Problem:
    """Flights and what was known before them; noise spectra are set by ``learn_noise``."""

    def __init__(
        self,
        flights: Sequence[Flight],
        model: Model,
        start: Point,
        own: Sequence[Variant] = (),
        motors_told: bool = False,
    ) -> None:
        """motors_told: rows show every setting of the motors (``prior_of``)."""
        self.flights = list(flights)
        self.frame = Frame(model_vehicle(model), model.motors, own=tuple(own))
        effects = self.frame.unknowns.items()
        tried = {k for v in self.frame.variants.values() if v.tried for k in v.keys} - {*start}
        measured = any(flight.rotor_measured for flight in flights)
        # A lag that the model has stays: with another its motors would not turn as they are driven.
        lags = measured and SENSOR_LAG not in start
        self.base_keys = (*BASE_KEYS, SENSOR_LAG) if lags else BASE_KEYS
        told = [key for key, one in effects if one.effect.role in CANDIDATES and key not in tried]
        self.every_key = (*self.base_keys, *told)
        lag = {SENSOR_LAG: sensor_lag(model)} if measured else {}
        self.start = {**lag, **start}
        unknowns = self.frame.unknowns.values()
        self.shared = [(k.key, k.parameter.shares) for k in unknowns if k.parameter.shares]
        self.prior, self.known_motor = prior_of(model, start, motors_told)
        if lags:
            weight = np.array([[LAG_DOUBT_S**-2]])
            centre = {SENSOR_LAG: self.start[SENSOR_LAG]}
            self.prior.append(Prior((SENSOR_LAG,), centre, weight))
        near = fitted_along(model) if measured else {}
        self.near: Point = {key: number for key, number in near.items() if key not in start}
        """Where columns are evaluated first: what the body's fit saw beside its constants."""
        self.trim = trim_of(model_vehicle(model))
        self.noise: dict[int, Noise] = {}
        self.shapes: dict[tuple[int, int], Noise] = {}
        self.motors: list[tuple[tuple[str, ...], Array]] | None = None
        """Keys and columns of a0, a1, a2 in each spectrum where the noise was learnt last."""

    def settle_filters(self) -> None:
        """Choose how far measured rates are believed: what predicts the next one best."""
        errors = np.mean(
            [rate_errors(f, self.frame, self.start, RATE_GAINS) for f in self.flights], axis=0
        )
        best = np.argmin(errors, axis=0)
        gains = tuple(RATE_GAINS[i] for i in best)
        self.frame = replace(self.frame, rate_gain=(gains[0], gains[1], gains[2]))

    def linear(self, point: Point, keys: Sequence[str], flights: Sequence[Flight]) -> Linear:
        """Evaluate flights at a point with the columns of ``keys``.

        Spectra are divided by what the noise of their flight is to that of all (``shapes``), and
        each flight has a lasting moment of its own about every axis, its trim, and a lasting
        offset of its gyro. Held to none, a search buys an even balance with a gain that answers to
        no torque, and an offset that flights of one craft share.
        """
        plain = linearise(flights, self.frame, point, keys)
        spectra: list[Spectrum] = []
        while plain.spectra:  # one by one and in place: they are hundreds of megabytes
            s = plain.spectra.pop(0)
            root = self.root(flights[s.flight], s.channel, s.hz)
            lasting = None if s.lasting is None else self._lasting(s.channel) * s.lasting / root
            np.divide(s.columns, root, out=s.columns)
            scaled = replace(s, residual=s.residual / root, lasting=lasting)
            spectra.append(trimmed(scaled, self.noise[s.channel]) if self.noise else scaled)
        return replace(plain, spectra=spectra)

    def _lasting(self, channel: int) -> float:
        """Standard deviation of what lasts for a flight and is another in the next: a moment in
        rad/s^2, or the gyro's offset in rad/s between it and the reported angles."""
        return self.trim[channel] if channel < ACCELEROMETER else GYRO_COUNT_RAD_S

    def root(self, flight: Flight, channel: int, hz: Array) -> Array:
        """What spectra of a flight's channel are divided by, at frequencies ``hz``."""
        shape = self.shapes.get((id(flight), channel))
        return np.ones(len(hz)) if shape is None else np.sqrt(shape.at(hz))

    def learn_trim(self, point: Point) -> None:
        """Expect no larger trims than what a point leaves of them, nor than were expected.

        Where an effect explains them (a centre of gravity off its place, say), flights hardly
        differ: what they then say together of its size counts again.
        """
        plain = linearise(self.flights, self.frame, point, (), range(ACCELEROMETER))
        squares: dict[int, list[float]] = {}
        for s in plain.spectra:
            assert s.lasting is not None
            root = self.root(self.flights[s.flight], s.channel, s.hz)
            own = s.lasting[0] * s.weight / self.noise[s.channel].at(s.hz) / root**2
            strength = float(own @ s.lasting[0])
            left = float(own @ s.residual) / strength
            squares.setdefault(s.channel, []).append(left**2 + 1.0 / strength)
        found = (
            min(most, float(np.sqrt(np.mean(squares.get(axis, [most**2])))))
            for axis, most in enumerate(self.trim)
        )
        roll, pitch, yaw = found
        self.trim = roll, pitch, yaw

    def learn_noise(self, linear: Linear) -> Linear:
        """Noise spectra from what a fit of every column at once leaves.

        One for all flights, and beside it each flight's own shape: a limit cycle or a propeller
        out of balance in one of them would leave none of them white, and in closed loop a wrong
        noise model is a wrong estimate. Returns ``linear`` divided by the new shapes.
        """
        used = [np.zeros(len(s.hz)) for s in linear.spectra]
        if not self.noise:
            # With any weights that are no prior at all the trim goes with the mean.
            even = [settled(s.residual, s.lasting, s.weight * 1e9) for s in linear.spectra]
            first = whiten_by_own(linear.spectra, even, used)
            linear = replace(linear, spectra=[trimmed(s, first[s.channel]) for s in linear.spectra])
        values = [s.residual for s in linear.spectra]
        for number in range(NOISE_ROUNDS if not self.noise else LATER_NOISE_ROUNDS):
            if self.noise and number == 0:
                noise = self.noise
            else:
                noise = whiten_by_own(linear.spectra, values, used)
                linear, values = self._reshape(linear, values, used)
            total = self.with_prior(linear, noise)
            covariance = inverse(total.normal)
            change = covariance @ total.gradient
            values = [s.residual - change[s.place] @ s.columns for s in linear.spectra]
            used = [leverage(s, noise[s.channel], covariance) for s in linear.spectra]
        self.noise = whiten_by_own(linear.spectra, values, used)
        self.motors = _motors_of(linear)
        return linear

    def _reshape(
        self, linear: Linear, values: Sequence[Array], used: Sequence[Array]
    ) -> tuple[Linear, list[Array]]:
        """Bring the shapes up to date with residuals ``values``; both divided accordingly."""
        if len(self.flights) < 2:
            return linear, list(values)
        spectra, left = [], []
        for s, residual, spent in zip(linear.spectra, values, used, strict=True):
            width = max(SHAPE_HZ, SHAPE_FREEDOM / float(s.weight.sum()) * 2.0 * s.hz[-1])
            # In the same bands: a mean over one is not what the spectrum is in its middle.
            alike = [i for i, other in enumerate(linear.spectra) if other.channel == s.channel]
            pooled = whiten_by_own(
                [linear.spectra[i] for i in alike],
                [values[i] for i in alike],
                [used[i] for i in alike],
                width,
            )[s.channel]
            own = whiten_by_own([s], [residual], [spent], width)[s.channel]
            ratio = Noise(own.hz, own.power / pooled.at(own.hz))
            key = (id(self.flights[s.flight]), s.channel)
            before = self.shapes.get(key)
            power = ratio.power if before is None else ratio.power * before.power
            self.shapes[key] = Noise(ratio.hz, power)
            root = np.sqrt(ratio.at(s.hz))
            lasting = None if s.lasting is None else s.lasting / root
            spectra.append(
                replace(s, residual=s.residual / root, columns=s.columns / root, lasting=lasting)
            )
            left.append(residual / root)
        return replace(linear, spectra=spectra), left

    def with_prior(self, linear: Linear, noise: Mapping[int, Noise] | None = None) -> Quadratic:
        """-2 log L around a linearisation, the prior included."""
        found = quadratic(
            linear.spectra,
            self.noise if noise is None else noise,
            linear.verticals,
            len(linear.keys),
        )
        normal, gradient, cost = found.normal, found.gradient, found.value
        for prior in self.prior:
            weight, slope, value = prior.at(linear.point)
            cost += value
            inside = [number for number, key in enumerate(prior.keys) if key in linear.keys]
            at = linear.place([prior.keys[number] for number in inside])
            normal[np.ix_(at, at)] += weight[np.ix_(inside, inside)]
            gradient[at] += slope[inside]
        return Quadratic(normal, gradient, cost)

    def fit(
        self, point: Point, keys: Sequence[str], steps: int = STEPS, settled: float = SETTLED
    ) -> Fit:
        """Gauss-Newton over ``keys`` with the noise as it is, each step with the curvature that the
        last one met, shortening those that do not help; never worse than where it starts, which is
        within the bounds.

        settled: drop of -2 log L that is not worth another step.
        """
        keys = tuple(keys)
        unknowns, free = self.frame.unknowns, np.ones(len(keys), np.bool_)
        point = bounded(point, keys, np.zeros(len(keys)), unknowns)
        now = self._whole(point, keys)
        normal = now.normal
        for _ in range(steps):
            at = np.array([value(point, key) for key in keys])
            low, high = (ends - at for ends in _ends(point, keys, unknowns))
            change = bounded_step(normal, now.gradient, free, low, high)
            share, moved, better = 1.0, point, now
            expected, step = 0.0, change
            for _ in range(4):
                moved = bounded(point, keys, share * change, unknowns)
                step = np.array([moved[key] for key in keys]) - at
                expected = float(2.0 * now.gradient @ step - step @ normal @ step)
                if expected < settled:
                    break
                better = self._whole(moved, keys)
                if better.value < now.value:
                    break
                # At best a parabola through both values gains this by another share of the step;
                # where it rises steeply it is none, and says nothing of a short one.
                slope = float(2.0 * now.gradient @ step)
                rise = min(better.value - now.value, slope)
                if slope**2 < settled * 4.0 * (rise + slope):
                    break
                share *= 0.3
            if expected < settled or not better.value < now.value:
                break
            gained = now.value - better.value
            normal = as_met(better.normal, step, now.gradient - better.gradient)
            point, now = moved, better
            if gained < settled:
                break
        return Fit(dict(point), keys, now.value, inverse(now.normal))

    def _whole(self, point: Point, keys: tuple[str, ...]) -> Quadratic:
        """-2 log L around a point, with one value for what two effects among ``keys`` share."""
        found = self.with_prior(self._again(point, keys))
        for key, other in self.shared:
            if key in keys and other in keys:
                at = [keys.index(key), keys.index(other)]
                apart = value(point, key) - value(point, other)
                weight = (SHARED * self.frame.unknowns[key].worth) ** -2
                found.normal[np.ix_(at, at)] += weight * np.array([[1.0, -1.0], [-1.0, 1.0]])
                found.gradient[at] -= weight * apart * np.array([1.0, -1.0])
                found = replace(found, value=found.value + weight * apart**2)
        return found

    def _again(self, point: Point, keys: tuple[str, ...]) -> Linear:
        """``linear`` with the columns of a0, a1, a2 from the last screening.

        They cost most, since motors must be simulated for each, and change least: the bench
        holds the constants where they are.
        """
        if self.motors is None:
            return self.linear(point, keys, self.flights)
        fresh = self.linear(point, [key for key in keys if key not in MOTOR_KEYS], self.flights)
        spectra = []
        for s, (names, known) in zip(fresh.spectra, self.motors, strict=True):
            rows = [i for i, name in enumerate(names) if name in keys]
            place = [keys.index(fresh.keys[i]) for i in s.place]
            place += [keys.index(names[i]) for i in rows]
            columns = np.concatenate([s.columns, known[rows]])
            spectra.append(replace(s, columns=columns, place=np.array(place, np.int64)))
        verticals = []
        for row in fresh.verticals:
            slopes = np.zeros(len(keys))
            slopes[[keys.index(key) for key in fresh.keys]] = row.slopes
            verticals.append(replace(row, slopes=slopes))
        return Linear(fresh.point, keys, spectra, verticals)


def _motors_of(linear: Linear) -> list[tuple[tuple[str, ...], Array]]:
    """Keys and columns (k, 2 m) of the motors in each spectrum."""
    motors = [linear.keys.index(key) for key in MOTOR_KEYS if key in linear.keys]
    found = []
    for s in linear.spectra:
        rows = np.flatnonzero(np.isin(s.place, motors))
        found.append((tuple(linear.keys[i] for i in s.place[rows]), s.columns[rows]))
    return found


def bounded(
    point: Point, keys: Sequence[str], change: Array, unknowns: Mapping[str, Key] = KEYS
) -> Point:
    """The point moved by ``change``, kept where the physics can be evaluated."""
    moved = np.array([value(point, key) for key in keys]) + change
    numbers = np.clip(moved, *_ends(point, keys, unknowns)).tolist()
    return {**point, **dict(zip(keys, numbers, strict=True))}


def _ends(point: Point, keys: Sequence[str], unknowns: Mapping[str, Key]) -> tuple[Array, Array]:
    """Least and largest value (p,) of each of ``keys`` with which the physics can be evaluated."""
    low, high = np.full(len(keys), -np.inf), np.full(len(keys), np.inf)
    for i, key in enumerate(keys):
        if key in BODY_KEYS or key in MOTOR_KEYS:
            low[i], high[i] = sorted((0.2 * point[key], 5.0 * point[key]))
        elif key == TIMING:
            low[i], high[i] = TIMING_BOUNDS
        elif key in unknowns:
            low[i], high[i] = unknowns[key].bounds
    return low, high
