"""The least-squares problem of a search: noise spectra, the likelihood of residuals by them, prior
knowledge, joint fits."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.dynamics.effect import CANDIDATES, Key
from groundstation.dynamics.model import EffectTerm, Estimate, Model, model_vehicle
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import Vehicle
from groundstation.identification.estimate import as_met, bounded_step, inverse
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.evaluation import (
    ACCELEROMETER,
    rate_errors,
)
from groundstation.identification.likelihood.linear import (
    Lately,
    Linear,
    Spectrum,
    Vertical,
)
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
from groundstation.telemetry.arrays import Array

# Generalised least squares in the frequency domain, over the full band.
#
# Residuals and columns of every flight and channel are tapered and transformed once. Dividing by a
# smooth noise spectrum whitens them; as long as the whole band is used, that is the same as
# one-step prediction with a causal noise model, and so free of bias in closed loop.


FIRST_BAND_HZ, WIDEST_BAND_HZ, GROWTH = 0.4, 3.0, 1.1


@dataclass(frozen=True, slots=True)
class Noise:
    """Power spectrum of one channel: (b,) band centres in Hz and power per degree of freedom."""

    hz: Array
    power: Array

    def at(self, hz: Array) -> Array:
        return np.exp(np.interp(hz, self.hz, np.log(self.power)))


@dataclass(frozen=True, slots=True)
class Quadratic:
    """-2 log L around a point: value - 2 gradient d + d normal d, normal (p, p)."""

    normal: Array
    gradient: Array
    value: float


def bands(top_hz: float, even_hz: float | None = None) -> Array:
    """Edges in Hz: narrow where motion is, wider above, or all ``even_hz`` apart."""
    if even_hz is not None:
        return np.linspace(0.0, top_hz * (1.0 + 1e-9), max(1, round(top_hz / even_hz)) + 1)
    edges, width = [0.0], FIRST_BAND_HZ
    while edges[-1] < top_hz:
        edges.append(edges[-1] + width)
        width = min(width * GROWTH, WIDEST_BAND_HZ)
    edges[-1] = top_hz * (1.0 + 1e-9)
    return np.array(edges)


def whiten_by_own(
    spectra: Sequence[Spectrum],
    values: Sequence[Array],
    used: Sequence[Array],
    even_hz: float | None = None,
) -> dict[int, Noise]:
    """Noise spectra per channel from residuals; used: degrees of freedom spent on each value.

    even_hz: width of the bands, instead of those of ``bands``.
    """
    noises: dict[int, Noise] = {}
    for channel in sorted({s.channel for s in spectra}):
        mine = [i for i, s in enumerate(spectra) if s.channel == channel]
        edges = bands(max(spectra[i].hz[-1] for i in mine), even_hz)
        power, count, free = (np.zeros(len(edges) - 1) for _ in range(3))
        for i in mine:
            band = np.searchsorted(edges, spectra[i].hz, side="right") - 1
            size = len(power)
            weight = spectra[i].weight
            power += np.bincount(band, weight * values[i] ** 2, size)[:size]
            count += 0.5 * np.bincount(band, weight, size)[:size]
            free += np.bincount(band, used[i], size)[:size]
        good = count > 0
        left = np.maximum(count - free, 0.3 * count)[good]
        middle = 0.5 * (edges[1:] + edges[:-1])[good]
        noises[channel] = Noise(middle, np.maximum(power[good] / left, 1e-30))
    return noises


def quadratic(
    spectra: Sequence[Spectrum],
    noises: Mapping[int, Noise],
    verticals: Sequence[Vertical],
    count: int,
) -> Quadratic:
    """-2 log L (without its constant) of residuals as a quadratic of ``count`` unknowns."""
    normal, gradient, value = np.zeros((count, count)), np.zeros(count), 0.0
    for s in spectra:
        scale = s.weight / noises[s.channel].at(s.hz)
        root = np.sqrt(scale)
        white, error = s.columns * root, s.residual * root
        normal[np.ix_(s.place, s.place)] += white @ white.T
        gradient[s.place] += white @ error
        value += float(error @ error)
    for row in verticals:
        scaled = row.slopes / row.sigma**2
        normal += np.outer(scaled, row.slopes)
        gradient += scaled * row.residual
        value += (row.residual / row.sigma) ** 2
    return Quadratic(normal, gradient, value)


def settled(rows: Array, lasting: Array | None, scale: Array) -> Array:
    """Rows (..., 2 m) as they count beside lasting signals of unknown sizes.

    lasting: (k, 2 m) of their expected sizes, the standard deviations of a normal prior. scale:
    (2 m,) weights of squares. Sums of weighted squares and products of the result are those in
    which the sizes have been integrated out.
    """
    if lasting is None:
        return rows
    strength, turn = np.linalg.eigh(lasting @ (scale * lasting).T)
    apart = turn.T @ lasting
    share = (1.0 - (1.0 + np.maximum(strength, 0.0)) ** -0.5) / np.maximum(strength, 1e-300)
    return rows - (share * (rows @ (scale * apart).T)) @ apart


def beside_lasting(s: Spectrum, rows: Array, noise: Noise) -> Array:
    """``settled`` for rows (..., 2 m) of a spectrum's channel under its noise."""
    return settled(rows, s.lasting, s.weight / noise.at(s.hz))


def trimmed(s: Spectrum, noise: Noise) -> Spectrum:
    """A spectrum as it counts beside what lasts for its flight."""
    residual, columns = (beside_lasting(s, rows, noise) for rows in (s.residual, s.columns))
    return replace(s, residual=residual, columns=columns)


def white_rows(s: Spectrum, noise: Noise, values: Array) -> Array:
    """Values (..., 2 m) of a spectrum's channel, whitened, as rows of time (..., n); the sums of
    their products, times half the sum of its weights, are those of the likelihood."""
    from scipy.fft import irfft

    white, bins = values * (1.0 / np.sqrt(noise.at(s.hz))), len(s.hz) // 2
    return irfft(white[..., :bins] + 1j * white[..., bins:], 2 * (bins - 1))


def leverage(spectrum: Spectrum, noise: Noise, covariance: Array) -> Array:
    """Degrees of freedom (2 m,) that a fit with this covariance takes from each value."""
    part = covariance[np.ix_(spectrum.place, spectrum.place)]
    scale = spectrum.weight / noise.at(spectrum.hz)
    turned = part @ spectrum.columns
    return scale * np.einsum("kn,kn->n", spectrum.columns, turned)


# Maximum likelihood with a noise spectrum of each flight's own, free at every frequency.
#
# Slow air and trim, which the controller answers, hold almost all power of a real flight, and
# vibration most of the rest: no rational noise model of moderate order whitens both. Here the
# spectrum of each flight and channel is the smoothed periodogram of its own residual, found by
# reweighting from white noise on (Whittle's likelihood, concentrated over the spectra). With
# the whole band in use this is prediction one step ahead with a causal noise model, and so free of
# bias in closed loop; a band cut out of it is not, quite, and is used to see whether an estimate
# moves.


HALF_WIDTH_HZ, LEAST_BINS = 0.8, 4
"""Half the width of the moving mean over a periodogram, and its least number of bins to a side: the
spectrum's shape below 4 Hz is what an estimate hangs on."""
REWEIGHTINGS, RELINEARISATIONS = 30, 8
STAYS = 0.02
"""Both end when nothing moves by more than this share of its standard error."""
WHITENER_BINS, WHITENER_ROWS = 2048, 400
WHITENER_HALF_WIDTH_HZ, SLOW_HZ = 3.0, 6.0


@dataclass(frozen=True, slots=True)
class FreeFit:
    """Where the likelihood is largest.

    point: the whole point; keys: what was estimated. normal: (p, p) information. cost: -2 log L
    with the spectra at their best, to be compared on the same flights. linear, powers, left: the
    last linearisation, the spectra (m,) and the residuals (2 m,), one for each flight and channel.
    """

    point: Point
    keys: tuple[str, ...]
    normal: Array
    cost: float
    linear: Linear
    powers: list[Array]
    left: list[Array]

    @property
    def values(self) -> Array:
        return np.array([value(self.point, key) for key in self.keys])

    @property
    def settled(self) -> bool:
        """Whether the last linearisation is as good as one at the point itself."""
        before = np.array([value(self.linear.point, key) for key in self.keys])
        errors = np.abs(self.values - before) * np.sqrt(np.diag(self.normal))
        return bool((errors < STAYS).all())


@dataclass(frozen=True, slots=True)
class Limits:
    """low, high: (p,) hard limits. step: (p,) the longest step from one linearisation."""

    low: Array
    high: Array
    step: Array

    def held(self, keys: Sequence[str], still: Sequence[str], at: Array | None = None) -> Limits:
        """The same where some keys stay (at 0, or at their values in ``at``)."""
        fixed = np.array([key in still for key in keys])
        values = np.zeros(len(keys)) if at is None else at
        low, high = (np.where(fixed, values, one) for one in (self.low, self.high))
        return replace(self, low=low, high=high)


def fit_free(
    linearise: Callable[[Point], Linear],
    start: Point | Linear,
    limits: Limits,
    white: bool = True,
) -> FreeFit:
    """Gauss-Newton with reweighting.

    linearise: residuals and columns at a point. start: a point, or a linearisation at it. white:
    the first weights; otherwise those of the residual at ``start``.
    """
    linear = start if isinstance(start, Linear) else linearise(start)
    point = linear.point if isinstance(start, Linear) else start
    keys = linear.keys
    powers = [np.ones(len(s.hz) // 2) for s in linear.spectra]
    if not white:
        powers = smoothed(linear.spectra, [s.residual for s in linear.spectra])
    longest, before = limits.step.copy(), np.zeros(len(keys))
    for number in range(RELINEARISATIONS):
        now = np.array([value(point, key) for key in keys])
        low = np.maximum(limits.low - now, -longest)
        high = np.minimum(limits.high - now, longest)
        change, normal, powers = reweighted(linear, powers, low, high)
        point = {**point, **dict(zip(keys, (now + change).tolist(), strict=True))}
        settled = np.all(np.abs(change) * np.sqrt(np.diag(normal)) < STAYS)
        if settled or number == RELINEARISATIONS - 1:
            break
        longest = np.where(change * before < 0.0, 0.5 * longest, longest)  # to and fro: shorter
        before = change
        linear = linearise(point)
    left = [s.residual - change[s.place] @ s.columns for s in linear.spectra]
    return FreeFit(point, keys, normal, cost_of(linear.spectra, powers, left), linear, powers, left)


def reweighted(
    linear: Linear, powers: list[Array], low: Array, high: Array
) -> tuple[Array, Array, list[Array]]:
    """The step from a linearisation at which weights and residuals agree.

    powers: first spectra. low, high: (p,) limits of the step. Returns the step
    (p,), its information (p, p) and the spectra.
    """
    count = len(linear.keys)
    change = np.zeros(count)
    normal, free = np.eye(count), np.ones(count, np.bool_)
    for _ in range(REWEIGHTINGS):
        normal, gradient = linear.equations(powers)
        moved = bounded_step(normal, gradient, free, low, high)
        error = np.abs(moved - change) * np.sqrt(np.diag(normal))
        change = moved
        left = [s.residual - change[s.place] @ s.columns for s in linear.spectra]
        powers = smoothed(linear.spectra, left)
        if error.max(initial=0.0) < STAYS:
            break
    return change, normal, powers


def smoothed(spectra: Sequence[Spectrum], values: Sequence[Array]) -> list[Array]:
    """Moving means (m,) of the periodograms of ``values``, one each."""
    from scipy.ndimage import uniform_filter1d

    found = []
    for s, one in zip(spectra, values, strict=True):
        real, imaginary = np.split(one, 2)
        power = uniform_filter1d(real**2 + imaginary**2, 2 * half_width(s) + 1, mode="reflect")
        found.append(np.maximum(power, 1e-30))
    return found


def half_width(s: Spectrum) -> int:
    """Of the moving mean over a spectrum's periodogram, in bins."""
    return max(LEAST_BINS, round(HALF_WIDTH_HZ / (s.hz[1] - s.hz[0])))


def without_upper_ends(linear: Linear, most_hz: float) -> Linear:
    """The same without frequencies that neither count, above ``most_hz``, nor are smoothed into
    some that do."""
    spectra = []
    for s in linear.spectra:
        kept = s.hz <= most_hz + (half_width(s) + 1) * (s.hz[1] - s.hz[0])
        rows = {name: getattr(s, name)[kept] for name in ("hz", "weight", "residual")}
        lasting = None if s.lasting is None else s.lasting[:, kept]
        spectra.append(replace(s, columns=s.columns[:, kept], lasting=lasting, **rows))
    return replace(linear, spectra=spectra)


def cost_of(spectra: Sequence[Spectrum], powers: Sequence[Array], left: Sequence[Array]) -> float:
    """-2 log L but for a constant."""
    total = 0.0
    for s, power, one in zip(spectra, powers, left, strict=True):
        half = len(power)
        periodogram = one[:half] ** 2 + one[half:] ** 2
        total += float(s.weight[:half] @ (np.log(power) + periodogram / power))
    return total


def unfitted(linear: Linear) -> tuple[list[Array], list[Array], float]:
    """What a linearisation leaves at its point: residuals (2 m,), their spectra (m,), -2 log L."""
    left = [s.residual for s in linear.spectra]
    powers = smoothed(linear.spectra, left)
    return left, powers, cost_of(linear.spectra, powers, left)


def joined(linear: Linear, key: str, parts: Mapping[str, float]) -> Linear:
    """The linearisation with several keys made one, whose unit moves each by its share.

    The new key stands where the first of them did.
    """
    first = next(iter(parts))
    keep = [one for one in linear.keys if one not in parts or one == first]
    new = {name: i for i, name in enumerate(keep)}
    keep[keep.index(first)] = key
    spectra = []
    for s in linear.spectra:
        names = [linear.keys[i] for i in s.place.tolist()]
        at = [new[first if name in parts else name] for name in names]
        place = sorted(set(at))
        columns = np.zeros((len(place), s.columns.shape[1]))
        for name, number, column in zip(names, at, s.columns, strict=True):
            columns[place.index(number)] += parts.get(name, 1.0) * column
        spectra.append(replace(s, columns=columns, place=np.array(place, np.int64)))
    return Linear(linear.point, tuple(keep), spectra, [])


def minimum_phase_whitener(fit: FreeFit, channel: int) -> Array:
    """Causal filter (k,) that whitens a channel's residual to unit variance.

    From the mean log spectrum of all flights by way of the cepstrum (Kolmogorov's factorisation).
    """
    from scipy.fft import irfft, rfft
    from scipy.ndimage import uniform_filter1d

    mine = [i for i, s in enumerate(fit.linear.spectra) if s.channel == channel]
    top = max(fit.linear.spectra[i].hz[-1] for i in mine)
    hz = np.linspace(0.0, top, WHITENER_BINS + 1)
    logs, total = np.zeros(len(hz)), 0.0
    for i in mine:
        s, power = fit.linear.spectra[i], fit.powers[i]
        share = float(s.weight.sum())
        logs += share * np.interp(hz, s.hz[: len(power)], np.log(power))
        total += share
    # What one flight's spectrum shows in detail is chance; the next flight's has another.
    width = 2 * round(WHITENER_HALF_WIDTH_HZ / hz[1]) + 1
    wide = uniform_filter1d(logs, width, mode="reflect")
    cepstrum = irfft(-0.5 * np.where(hz > SLOW_HZ, wide, logs) / total)
    size = len(cepstrum)
    cepstrum[1 : size // 2] *= 2.0
    cepstrum[size // 2 + 1 :] = 0.0
    return irfft(np.exp(rfft(cepstrum)))[:WHITENER_ROWS]


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
        self._lately = Lately()

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
        plain = self.plain(point, keys, flights)
        spectra: list[Spectrum] = []
        while plain.spectra:  # one by one and in place: they are hundreds of megabytes
            s = plain.spectra.pop(0)
            root = self.root(flights[s.flight], s.channel, s.hz)
            lasting = None if s.lasting is None else self._lasting(s.channel) * s.lasting / root
            np.divide(s.columns, root, out=s.columns)
            scaled = replace(s, residual=s.residual / root, lasting=lasting)
            spectra.append(trimmed(scaled, self.noise[s.channel]) if self.noise else scaled)
        return replace(plain, spectra=spectra)

    def plain(self, point: Point, keys: Sequence[str], flights: Sequence[Flight]) -> Linear:
        """The same before any noise is known: only columns are not shared with what is kept."""
        return self._lately.linearise(flights, self.frame, point, keys)

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
        squares: dict[int, list[float]] = {}
        for s in self.plain(point, (), self.flights).spectra:
            if s.channel >= ACCELEROMETER:
                continue
            assert s.lasting is not None
            root = self.root(self.flights[s.flight], s.channel, s.hz)
            own = s.lasting[0] * s.weight / self.noise[s.channel].at(s.hz) / root**2
            strength = float(own @ s.lasting[0])
            left = float(own @ s.residual) / strength
            squares.setdefault(s.channel, []).append(left**2 + 1.0 / strength)
        roll, pitch, yaw = (
            min(most, float(np.sqrt(np.mean(squares.get(axis, [most**2])))))
            for axis, most in enumerate(self.trim)
        )
        self.trim = roll, pitch, yaw

    def learn_noise(self, linear: Linear) -> Linear:
        """Noise spectra from what a fit of every column at once leaves.

        One for all flights, and beside it each flight's own shape: a limit cycle or a propeller
        out of balance in one of them would leave none of them white, and in closed loop a wrong
        noise model is a wrong estimate. Returns ``linear`` divided by the new shapes, in place.
        """
        used = [np.zeros(len(s.hz)) for s in linear.spectra]
        if not self.noise:
            # With any weights that are no prior at all the trim goes with the mean.
            even = [settled(s.residual, s.lasting, s.weight * 1e9) for s in linear.spectra]
            first = whiten_by_own(linear.spectra, even, used)
            for number, s in enumerate(linear.spectra):
                linear.spectra[number] = trimmed(s, first[s.channel])
        values = [s.residual for s in linear.spectra]
        for number in range(NOISE_ROUNDS if not self.noise else LATER_NOISE_ROUNDS):
            if self.noise and number == 0:
                noise = self.noise
            else:
                noise = whiten_by_own(linear.spectra, values, used)
                values = self._reshape(linear, values, used)
            total = self.with_prior(linear, noise)
            covariance = inverse(total.normal)
            change = covariance @ total.gradient
            values = [s.residual - change[s.place] @ s.columns for s in linear.spectra]
            used = [leverage(s, noise[s.channel], covariance) for s in linear.spectra]
        self.noise = whiten_by_own(linear.spectra, values, used)
        motors, self.motors = linear.place([k for k in MOTOR_KEYS if k in linear.keys]), []
        for s in linear.spectra:
            rows = np.flatnonzero(np.isin(s.place, motors))
            self.motors.append((tuple(linear.keys[i] for i in s.place[rows]), s.columns[rows]))
        return linear

    def _reshape(
        self, linear: Linear, values: Sequence[Array], used: Sequence[Array]
    ) -> list[Array]:
        """Bring the shapes up to date with residuals ``values``; both divided accordingly, the
        linearisation in place."""
        if len(self.flights) < 2:
            return list(values)
        left = []
        for number, (residual, spent) in enumerate(zip(values, used, strict=True)):
            s = linear.spectra[number]
            width = max(SHAPE_HZ, SHAPE_FREEDOM / float(s.weight.sum()) * 2.0 * s.hz[-1])
            # In the same bands: a mean over one is not what the spectrum is in its middle.
            alike = [i for i, other in enumerate(linear.spectra) if other.channel == s.channel]
            left_of, spent_of = ([every[i] for i in alike] for every in (values, used))
            of_all = [linear.spectra[i] for i in alike], left_of, spent_of
            pooled = whiten_by_own(*of_all, width)[s.channel]
            own = whiten_by_own([s], [residual], [spent], width)[s.channel]
            ratio = Noise(own.hz, own.power / pooled.at(own.hz))
            key = (id(self.flights[s.flight]), s.channel)
            before = self.shapes.get(key)
            power = ratio.power if before is None else ratio.power * before.power
            self.shapes[key] = Noise(ratio.hz, power)
            root = np.sqrt(ratio.at(s.hz))
            lasting = None if s.lasting is None else s.lasting / root
            np.divide(s.columns, root, out=s.columns)
            linear.spectra[number] = replace(s, residual=s.residual / root, lasting=lasting)
            left.append(residual / root)
        return left

    def with_prior(self, linear: Linear, noise: Mapping[int, Noise] | None = None) -> Quadratic:
        """-2 log L around a linearisation, the prior included."""
        noise = self.noise if noise is None else noise
        found = quadratic(linear.spectra, noise, linear.verticals, len(linear.keys))
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
        self,
        point: Point,
        keys: Sequence[str],
        steps: int = STEPS,
        settled: float = SETTLED,
        rough: bool = False,
    ) -> Fit:
        """Gauss-Newton over ``keys`` with the noise as it is, each step with the curvature that the
        last one met, shortening those that do not help; never worse than where it starts, which is
        within the bounds.

        settled: drop of -2 log L that is not worth another step. rough: with the columns of the
        start throughout, which take most of the time.
        """
        keys = tuple(keys)
        unknowns, free = self.frame.unknowns, np.ones(len(keys), np.bool_)
        point = bounded(point, keys, np.zeros(len(keys)), unknowns)
        columns = self._again(point, keys)
        now = self._whole(columns, keys)
        normal = now.normal
        for _ in range(steps):
            at = np.array([value(point, key) for key in keys])
            low, high = (ends - at for ends in _ends(point, keys, unknowns))
            change = bounded_step(normal, now.gradient, free, low, high)
            share, moved, cost = 1.0, point, now.value
            expected, step = 0.0, change
            for _ in range(4):
                moved = bounded(point, keys, share * change, unknowns)
                step = np.array([moved[key] for key in keys]) - at
                expected = float(2.0 * now.gradient @ step - step @ normal @ step)
                if expected < settled:
                    break
                cost = self._cost(moved, keys)
                if cost < now.value:
                    break
                # At best a parabola through both values gains this by another share of the step;
                # where it rises steeply it is none, and says nothing of a short one.
                slope = float(2.0 * now.gradient @ step)
                rise = min(cost - now.value, slope)
                if slope**2 < settled * 4.0 * (rise + slope):
                    break
                share *= 0.3
            if expected < settled or not cost < now.value:
                break
            columns = self._beside(columns, moved) if rough else self._again(moved, keys)
            better = self._whole(columns, keys)
            gained = now.value - better.value
            normal = as_met(better.normal, step, now.gradient - better.gradient)
            point, now = moved, better
            if gained < settled:
                break
        return Fit(dict(point), keys, now.value, inverse(now.normal))

    def better(self, one: Point, other: Point, keys: Sequence[str]) -> Point:
        """Of two points the one from which a joint fit of ``keys`` has the shorter way."""
        return min(one, other, key=lambda point: self._cost(point, tuple(keys)))

    def _cost(self, point: Point, keys: tuple[str, ...]) -> float:
        """-2 log L at a point."""
        found = self.with_prior(self.linear(point, (), self.flights)).value
        return found + sum(weight * apart**2 for _, weight, apart in self._agreeing(point, keys))

    def _whole(self, linear: Linear, keys: tuple[str, ...]) -> Quadratic:
        """-2 log L around a point, with one value for what two effects among ``keys`` share."""
        found = self.with_prior(linear)
        for at, weight, apart in self._agreeing(linear.point, keys):
            found.normal[np.ix_(at, at)] += weight * np.array([[1.0, -1.0], [-1.0, 1.0]])
            found.gradient[at] -= weight * apart * np.array([1.0, -1.0])
            found = replace(found, value=found.value + weight * apart**2)
        return found

    def _agreeing(
        self, point: Point, keys: tuple[str, ...]
    ) -> Iterator[tuple[list[int], float, float]]:
        """Places of two keys that share a number, the weight of its difference, and that."""
        for key, other in self.shared:
            if key in keys and other in keys:
                weight = (SHARED * self.frame.unknowns[key].worth) ** -2
                apart = value(point, key) - value(point, other)
                yield [keys.index(key), keys.index(other)], weight, apart

    def _beside(self, columns: Linear, point: Point) -> Linear:
        """What flights leave at a point, beside columns of another."""
        left = self.linear(point, (), self.flights)
        spectra = [
            replace(own, residual=s.residual)
            for own, s in zip(columns.spectra, left.spectra, strict=True)
        ]
        verticals = [
            replace(own, residual=row.residual)
            for own, row in zip(columns.verticals, left.verticals, strict=True)
        ]
        return Linear(left.point, columns.keys, spectra, verticals)

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
