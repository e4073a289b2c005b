"""A model against recordings: prediction errors beside the noise floor, and where they
disagree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from groundstation.comparison.consistency import (
    driven_by_speeds,
    require_channels,
    require_consistent,
    require_flight,
    require_predictions,
)
from groundstation.comparison.gap import (
    CHANNELS,
    FURTHER_EVERY_S,
    FURTHER_S,
    HORIZONS_S,
    PER_SI,
    UNITS,
    WHOLE,
    AheadErrors,
    ahead_errors,
    motion_of,
    overall,
    pooled_rms,
    regimes_of,
)
from groundstation.comparison.noise_floor import BlackBox, Floor, floor_errors, learn, prepare
from groundstation.dynamics.model import Model, Turning, model_vehicle, require_body
from groundstation.identification.runs import Run, without_gaps
from groundstation.report.page import Result
from groundstation.telemetry.arrays import Array

# Where a model and recordings disagree: by channel and regime, by time, by frequency.


BLOCK_S = 0.25
"""Errors of one horizon forget each other within a fraction of this."""
WORST_S, WINDOW_S = 2.0, 1.0
"""What is drawn of a channel at its worst, and the windows in which errors are drawn over time."""
LEAST_S = 0.5
"""A regime that lasts less in all recordings together says nothing."""
SPECTRUM_ROWS = 512
LONGEST_GAP = 20
"""Rows without a value that a spectrum bridges by zeros."""
RATE_OF = dict(zip(CHANNELS[6:], CHANNELS[:3], strict=True))
SHARE, LEAST = 0.25, 3.0
"""An angle integrates its rate: it names a place only where the rate says much less, as it does
where gyro and attitude disagree."""


@dataclass(frozen=True, slots=True)
class Place:
    """One channel in one regime.

    rms, expected_rms: errors 20 and 50 ms ahead together, and what noise alone leaves, in
    ``unit``. significance: excess of the squared error in standard deviations that the noise's
    own energy has over as many rows. seconds: how long the regime lasted.
    """

    channel: str
    regime: str
    rms: float
    expected_rms: float
    unit: str
    significance: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Stretch:
    """Where in time one channel is predicted worst: run index, first and last row, its excess."""

    channel: str
    run: int
    first: int
    last: int
    excess: float


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Power densities (m,) of one channel's errors at its shortest horizon, and of what a perfect
    observer would leave of them (flat), in unit^2/Hz, over frequency_hz (m,)."""

    channel: str
    frequency_hz: Array
    error: Array
    expected: Array


def where(errors: Sequence[AheadErrors], floors: Sequence[Floor]) -> list[Place]:
    """Every channel in every regime, the most significant excess first.

    errors: of the model on the runs; floors: what the black box leaves, in the same rows.
    """
    places = []
    energy = [_energies(one, floor) for one, floor in zip(errors, floors, strict=True)]
    deviation = _deviation(energy, errors)
    regimes = [regimes_of(one.run, one.motion) for one in errors]
    for regime in regimes[0]:
        held = [masks[regime] for masks in regimes]
        seconds = sum(
            float(mask.sum()) * one.run.period_s for mask, one in zip(held, errors, strict=True)
        )
        if seconds < LEAST_S:
            continue
        for channel, name in enumerate(CHANNELS):
            mine, noise, count = 0.0, 0.0, 0
            for (error, floor), mask in zip(energy, held, strict=True):
                known = mask & np.isfinite(error[:, channel]) & np.isfinite(floor[:, channel])
                mine += float(error[known, channel].sum())
                noise += float(floor[known, channel].sum())
                count += int(known.sum())
            if not count:
                continue
            size = deviation[channel] * np.sqrt(seconds / BLOCK_S)
            excess = (mine - noise) / count * (seconds / BLOCK_S)
            places.append(
                Place(
                    name,
                    regime,
                    float(np.sqrt(mine / count) * PER_SI[channel]),
                    float(np.sqrt(noise / count) * PER_SI[channel]),
                    UNITS[name],
                    float(excess / size) if size > 0 else 0.0,
                    seconds,
                )
            )
    return _ranked(places)


def _ranked(places: Sequence[Place]) -> list[Place]:
    """The most significant first, but an angle behind the rate that already tells its error."""
    rates = {(p.channel, p.regime): p.significance for p in places}

    def key(place: Place) -> tuple[float, bool]:
        rate = rates.get((RATE_OF.get(place.channel, ""), place.regime), 0.0)
        follows = rate > max(SHARE * place.significance, LEAST)
        told = min(place.significance, 0.99 * rate) if follows else place.significance
        # Equal significance: the whole flight says less than a regime.
        return -told, place.regime == WHOLE

    return sorted(places, key=key)


def worst_stretch(
    errors: Sequence[AheadErrors], floors: Sequence[Floor], channel: str
) -> Stretch | None:
    """The stretch of ``WORST_S`` of a channel whose squared error exceeds the noise most."""
    place = CHANNELS.index(channel)
    best: Stretch | None = None
    for number, (one, floor) in enumerate(zip(errors, floors, strict=True)):
        error, noise = _energies(one, floor)
        more = np.nan_to_num(error[:, place] - noise[:, place])
        rows = max(1, min(round(WORST_S / one.run.period_s), len(more)))
        total = np.cumsum(np.concatenate([[0.0], more]))
        mean = (total[rows:] - total[:-rows]) / rows
        first = int(np.argmax(mean))
        if best is None or mean[first] > best.excess:
            best = Stretch(channel, number, first, first + rows, float(mean[first]))
    return best


def over_time(errors: AheadErrors, floor: Floor) -> tuple[Array, Array]:
    """(seconds (m,), error over noise (m, 9)) in windows of ``WINDOW_S``; NaN where not flown.

    The noise is the channel's over the whole run: a window may be too quiet to tell its own.
    """
    error, noise = _energies(errors, floor)
    rows = max(1, round(WINDOW_S / errors.run.period_s))
    count = max(1, len(error) // rows)
    usual = np.sqrt(_mean(noise, axis=0))
    parts = error[: count * rows].reshape(count, -1, 9) if len(error) >= rows else error[None]
    time = errors.run.time_s[0] + WINDOW_S * (np.arange(count) + 0.5)
    return time, np.sqrt(_mean(parts, axis=1)) / usual


def spectrum_of(
    errors: Sequence[AheadErrors], floors: Sequence[Floor], channel: str
) -> Spectrum | None:
    """Spectra of one channel's errors at its shortest horizon, and of what noise leaves of them.

    None where no stretch is long enough.
    """
    from scipy.signal import welch

    place = CHANNELS.index(channel)
    sums: list[Array] = []
    weight = 0.0
    frequency = np.zeros(0)
    for one, floor in zip(errors, floors, strict=True):
        step = int(one.step_rows[place])
        known = np.flatnonzero(np.isfinite(one.step[:, place] + floor.step[:, place]))
        if len(known) < SPECTRUM_ROWS:
            continue
        breaks = np.flatnonzero(np.diff(known) > LONGEST_GAP * step) + 1
        for rows in np.split(known, breaks):
            every = np.arange(rows[0], rows[-1] + 1, step)
            if len(every) < SPECTRUM_ROWS:
                continue
            pair = np.stack([one.step[every, place], floor.step[every, place]]) * PER_SI[place]
            frequency, power = welch(
                np.nan_to_num(pair),
                1.0 / (step * one.run.period_s),
                nperseg=SPECTRUM_ROWS,
                detrend=False,
            )
            sums.append(power * len(every) ** 2 / len(rows))
            weight += len(every)
    if not sums:
        return None
    mean = sum(sums[1:], sums[0]) / weight
    # A perfect observer's errors are white.
    expected = np.full(len(frequency), float(mean[1].mean()))
    return Spectrum(channel, frequency, mean[0], expected)


def _energies(errors: AheadErrors, floor: Floor) -> tuple[Array, Array]:
    """Squared errors (n, 9), mean over the horizons, of the model and of the black box."""
    mine = np.mean([np.square(one) for one in errors.horizons], axis=0)
    noise = np.mean([np.square(one) for one in floor.horizons], axis=0)
    return mine, noise


def _deviation(energy: Sequence[tuple[Array, Array]], errors: Sequence[AheadErrors]) -> Array:
    """Standard deviation (9,) of the noise's mean energy over one block."""
    means = []
    for (_, noise), one in zip(energy, errors, strict=True):
        rows = max(1, round(BLOCK_S / one.run.period_s))
        count = len(noise) // rows
        if count:
            means.append(_mean(noise[: count * rows].reshape(count, rows, 9), axis=1))
    blocks = np.vstack(means) if means else np.zeros((1, 9))
    found = np.zeros(9)
    for channel in range(9):
        values = blocks[np.isfinite(blocks[:, channel]), channel]
        found[channel] = values.std() if len(values) > 1 else 0.0
    return found


def _mean(values: Array, axis: int) -> Array:
    """Mean of the finite values, NaN where there is none."""
    known = np.isfinite(values)
    count = known.sum(axis=axis)
    total = np.where(known, values, 0.0).sum(axis=axis)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


# A model against recordings: its prediction errors beside the noise floor of the same rows.


@dataclass(frozen=True, repr=False)
class Comparison(Result):
    """One model on some runs.

    errors, floors: one of each per run. black_box: what the floors come from. turning: what of the
    model turns the craft. warnings: recordings whose predictions are not driven by their PWM, and
    why. horizons_s: how far ahead.
    """

    model: Model
    errors: tuple[AheadErrors, ...]
    floors: tuple[Floor, ...]
    black_box: BlackBox
    turning: Turning = "body"
    warnings: Mapping[str, str] = field(default_factory=dict)
    horizons_s: tuple[float, ...] = HORIZONS_S
    SHOWN_BY: ClassVar[str] = "groundstation.discrepancy.report:comparison"

    def _what(self) -> str:
        names = ", ".join(dict.fromkeys(one.run.name for one in self.errors))
        return f"{names}: prediction errors {self.gap:.2f} times noise"

    @cached_property
    def rms(self) -> Array:
        """Of the errors at all horizons, (9,), SI."""
        return pooled_rms([error for one in self.errors for error in one.horizons])

    @cached_property
    def noise_floor(self) -> Array:
        """The same of what noise leaves, (9,), SI."""
        return pooled_rms([error for one in self.floors for error in one.horizons])

    @property
    def gap(self) -> float:
        """All channels in one number; 1.0 says that nothing is left to explain."""
        return overall(self.rms, self.noise_floor)

    def beside(self, other: Comparison) -> float:
        """The gap in units of another comparison's noise floor."""
        return overall(self.rms, other.noise_floor)

    @cached_property
    def places(self) -> list[Place]:
        """Channel by regime, the most significant excess first."""
        return where(self.errors, self.floors)

    def at_horizon(self, number: int) -> tuple[Array, Array]:
        """(error, noise floor), (9,) each, SI, at one of ``horizons_s``."""
        error = pooled_rms([one.horizons[number] for one in self.errors])
        return error, pooled_rms([one.horizons[number] for one in self.floors])

    def with_model(
        self, model: Model, every_s: float = 0.0, same_observer: bool = False
    ) -> Comparison:
        """Another model on the same runs, beside the same floor. every_s: predictions start no more
        often than that. same_observer: of one that hardly differs, with the noise that suits this
        one."""
        if model == self.model:  # which noise suits it is known, and perhaps what it predicts
            fewer = [one.begun_every(every_s) for one in self.errors]
            if all(fewer):
                return replace(self, errors=tuple(one for one in fewer if one is not None))
            same_observer = True
        errors = self._ahead(model, every_s, same_observer, self.horizons_s)
        return replace(self, model=model, errors=errors)

    def further(self, black_box: BlackBox | None = None) -> Comparison:
        """The same model on the same rows 200 and 500 ms ahead, beside the noise floor there.

        black_box: learnt that far ahead on other runs; None: learnt on these.
        """
        errors = self._ahead(self.model, FURTHER_EVERY_S, True, FURTHER_S)
        floors, learnt = _floors(errors, self.model, black_box, self)
        far = replace(self, errors=errors, horizons_s=FURTHER_S)
        return replace(far, floors=floors, black_box=learnt)

    def _ahead(
        self, model: Model, every_s: float, same_observer: bool, horizons_s: tuple[float, ...]
    ) -> tuple[AheadErrors, ...]:
        return tuple(
            ahead_errors(
                one.recorded,
                model,
                like=one,
                same_observer=same_observer,
                turning=self.turning,
                every_s=every_s,
                horizons_s=horizons_s,
            )
            for one in self.errors
        )


@dataclass(frozen=True, slots=True)
class Judged:
    """Rows ``first`` to ``last`` of a run; those before only tell the state in which it begins."""

    run: Run
    first: int
    last: int


def compare(
    flights: Sequence[Run | Judged],
    model: Model,
    black_box: BlackBox | None = None,
    turning: Turning = "body",
) -> Comparison:
    """Judge a model on runs (``runs.flights_of``), or on parts of them.

    black_box: learnt on other runs, so that it has not seen these; None: learnt on these.
    turning: what turns the craft, the model's body or its ARX polynomials.

    Raises BadInputError where the model has no body or is another craft's, where channels that
    every prediction needs are missing or do not fit together, and where nothing flies.
    """
    parts = [one if isinstance(one, Judged) else Judged(one, 0, len(one)) for one in flights]
    require_channels([part.run for part in parts])
    require_body(model)
    motions = [motion_of(without_gaps(part.run), model) for part in parts]
    require_consistent([part.run for part in parts], model, motions)
    warnings: dict[str, str] = {}
    for number, (part, motion) in enumerate(zip(parts, motions, strict=True)):
        run, why = driven_by_speeds(part.run, model, motion)
        if why:
            parts[number], warnings[run.name] = replace(part, run=run), why
            motions[number] = motion_of(without_gaps(run), model)
    errors = tuple(
        ahead_errors(part.run, model, slice(part.first, part.last), motion=motion, turning=turning)
        for part, motion in zip(parts, motions, strict=True)
    )
    require_flight(errors)
    require_predictions(errors)
    floors, learnt = _floors(errors, model, black_box)
    return Comparison(model, errors, floors, learnt, turning, warnings)


def _floors(
    errors: Sequence[AheadErrors],
    model: Model,
    black_box: BlackBox | None,
    near: Comparison | None = None,
) -> tuple[tuple[Floor, ...], BlackBox]:
    """near: with the same errors at other horizons."""
    configuration = model_vehicle(model).configuration
    known = [None] * len(errors) if near is None else near.floors
    prepared = [prepare(one, configuration, own) for one, own in zip(errors, known, strict=True)]
    learnt = black_box
    if learnt is None:
        learnt = learn(prepared, None if near is None else near.black_box)
    return tuple(floor_errors(learnt, one) for one in prepared), learnt
