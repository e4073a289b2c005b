"""What a search found, and the proof: the improved model on flights that no choice has seen."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal

import msgspec
import numpy as np

from groundstation.comparison.comparison import Comparison
from groundstation.comparison.gap import CHANNELS, FURTHER_EVERY_S, AheadErrors
from groundstation.dynamics.model import Disturbance, Estimate, Model
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import filled

# What a search for missing effects found.
#
# ``find_discrepancy`` in ``engine.py`` makes it. Everything in it is plain numbers in the units of
# the model file, so that a report needs no knowledge of how it was found; its parts are parts of
# the report's JSON (``report_json.py``).


class Verdict(StrEnum):
    """The outcome in one word, as in the report's JSON."""

    EFFECTS_FOUND = "effects_found"
    """Effects are named, and with them predictions of proof samples err by no more than noise."""
    FOUND_IN_PART = "found_in_part"
    """Effects are named, and with them predictions still err by more than noise."""
    NO_DISCREPANCY = "no_discrepancy"
    """Predictions err by no more than noise, with the constants that changed if any did."""
    UNEXPLAINED = "unexplained"
    """Predictions err by more than noise, and no effect in the list takes a tenth of that off."""


class Reason(StrEnum):
    """Why a candidate is not named; the gate that refused it (``acceptance.py``)."""

    WEAK = "weak"
    """Nothing significant is left for it."""
    WRONG_SIGN = "wrong_sign"
    """It fits only with a sign that physics does not allow."""
    IMPLAUSIBLE = "implausible"
    """No small craft has it in that size."""
    INSIGNIFICANT = "insignificant"
    """Chance can do it."""
    NOT_HELD_OUT = "not_held_out"
    """Flights that its size was not taken from are not explained better."""
    NOT_ALONE = "not_alone"
    """Others of its kind do the same, none clearly more than the rest."""
    BETWEEN_ROWS = "between_rows"
    """Settings of the motors that no row shows can do as much."""
    SUPERFLUOUS = "superfluous"
    """It joined, and is not needed since others have."""
    RECORDINGS_DISAGREE = "recordings_disagree"
    """Recordings tell different sizes; one that is fitted along is possible."""
    PREDICTS_WORSE = "predicts_worse"
    """With it fitted samples are predicted worse, 20 and 50 ms ahead, than without."""
    WITHOUT_WEIGHT = "without_weight"
    """It is possible: fitted along, but predictions are hardly better with it."""
    NOT_RECURRENT = "not_recurrent"
    """It is possible: fitted along, but other stretches and flights would choose others."""
    NEGLIGIBLE = "negligible"
    """It is fitted along, and too small to be called an effect."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """A reason for programs, and the same in words with its numbers."""

    reason: Reason
    words: str


@dataclass(frozen=True, slots=True)
class Alternative:
    """Another name that explains nearly as much.

    margin: how much worse its penalised likelihood is (difference of -2 log L; 0 is equal, 10
    is one chance in 150). manoeuvre: what to fly to tell the two apart. share: of the resamples
    (``recurrence.py``) in which it was chosen and the name was not.
    """

    name: str
    margin: float
    manoeuvre: str
    share: float = 0.0


class Step(msgspec.Struct, frozen=True):
    """The gap on proof samples, all channels, before and after an effect joined."""

    before: float
    after: float


UNPROVEN = Step(math.nan, math.nan)


class EffectFound(msgspec.Struct, frozen=True):
    """An accepted effect.

    order: 1 for the first one accepted. adds: its law in words. parameters: by name, in the model
    file's units, from the last joint fit. evidence: ``likelihood_ratio`` (drop of -2 log L when it
    joined), ``t`` (from scores summed over blocks of time), ``held_out`` (drop of -2 log L on
    flights that its size was not taken from) and ``held_out_expected`` (of one that has the fitted
    size there); ``over_others``: standard errors by which a rotor shakes more than the others
    together. gap: NaN until it is proven. weight: its share of what all names explain on proof
    samples. recurrence: share of resamples of blocks of time and flights that choose it (None: none
    drawn).
    """

    name: str
    order: int
    adds: str
    parameters: dict[str, Estimate]
    evidence: dict[str, float]
    alternatives: tuple[Alternative, ...]
    gap: Step
    channels: tuple[str, ...]
    weight: float | None = None
    recurrence: float | None = None

    @property
    def gap_before(self) -> float:
        return self.gap.before

    @property
    def gap_after(self) -> float:
        return self.gap.after

    def doubted(self, why: Refusal) -> PossibleEffect:
        """The same, fitted along without a name."""
        share = math.nan if self.recurrence is None else self.recurrence
        reason = why.reason.value
        return PossibleEffect(self.name, self.parameters, share, self.alternatives, reason)


class PossibleEffect(msgspec.Struct, frozen=True):
    """One that is fitted along and not named. reason: as ``refused_by`` of a candidate."""

    name: str
    parameters: dict[str, Estimate]
    recurrence: float
    alternatives: tuple[Alternative, ...]
    reason: str = "not_recurrent"


class Candidate(msgspec.Struct, frozen=True):
    """What came of one effect, accepted or not.

    score: drop of -2 log L when it alone joins the base (screening). t: its largest
    parameter over its standard error. held_out: drop of -2 log L on flights that its size was not
    taken from, in the last round it took part in. reason: why it is not named, in words;
    refused_by: the same as one of ``Reason``; both are empty where it is named or was not asked.
    """

    name: str
    score: float
    t: float
    held_out: float
    accepted: bool
    reason: str = ""
    refused_by: str = ""

    def refused(self, why: Refusal) -> Candidate:
        return msgspec.structs.replace(
            self, accepted=False, reason=why.words, refused_by=why.reason.value
        )


@dataclass(frozen=True, slots=True)
class NotShown:
    """An effect that these recordings cannot show.

    stderr: that they would give to ``parameter``, None where nothing of it shows in them;
    plausible: a usual size of it; manoeuvre: what to fly, or which channel to record.
    """

    name: str
    parameter: str
    stderr: float | None
    plausible: float
    unit: str
    manoeuvre: str


class Changed(msgspec.Struct, frozen=True):
    """A constant of the given model that the search changed: name and unit as in the model file.

    stderr: of the new value, None where it is not known. percent: of the given one, None where that
    is zero. words: the change, and what it may mean.
    """

    name: str
    given: float = msgspec.field(name="from")
    value: float = msgspec.field(name="to")
    stderr: float | None
    percent: float | None
    words: str


class Leftover(msgspec.Struct, frozen=True):
    """What is left after the last accepted effect.

    channel: the worst one, empty where all is white. frequencies_hz: where its residual rises above
    coloured noise. signal: the strongest generic signal in it, in words. excess: residual over
    expected power of that channel where it is worst.
    """

    channel: str = ""
    frequencies_hz: tuple[float, ...] = ()
    signal: str = ""
    excess: float = 1.0

    @property
    def verdict(self) -> Literal["white", "structured"]:
        return "structured" if self.channel else "white"


@dataclass(frozen=True, slots=True)
class Findings:
    """The outcome of ``find_effects``.

    effects: accepted, in order; models: final constants, with the effects up to each. possible:
    fitted along, and too doubtful to be named. base: the model as it was given; given: the same
    with the disturbance that it leaves. base_changes: constants of it that moved; those that these
    data cannot improve have not. moved: the given model with these changes and with what is fitted
    and has no name. model: moved constants and effects, fitted jointly, and the disturbance that is
    left. candidates: every effect, strongest first. not_shown: excitation check. lost: effect name
    -> the channel that is missing to show it. warnings: in words.
    """

    verdict: Verdict
    effects: tuple[EffectFound, ...]
    models: tuple[Model, ...]
    base: Model
    given: Model
    moved: Model
    model: Model
    base_changes: tuple[Changed, ...]
    candidates: tuple[Candidate, ...]
    not_shown: tuple[NotShown, ...]
    lost: dict[str, str]
    residual: Leftover
    warnings: tuple[str, ...] = field(default=())
    possible: tuple[PossibleEffect, ...] = ()


@dataclass(frozen=True, slots=True)
class Predicted:
    """gap: over all channels on fitted samples. worse: channel -> by how many standard errors it is
    predicted worse than by the given model. gaps: of each channel (9,), NaN where it is absent."""

    gap: float
    worse: dict[int, float]
    gaps: tuple[float, ...] = ()

    @property
    def badness(self) -> tuple[float, float]:
        return sum(self.worse.values()), self.gap


# The proof of a finding: gaps before and after on samples that decided nothing.


GIVEN, BASE = "given model", "base constants"
"""Names of the first steps of a proof."""
BLOCK_S = 1.0
"""Errors of neighbouring rows share their rows; those of seconds apart do not."""
LEAST_SHARE = 0.02
"""Of a prediction error, the least that counts as a change."""
WORSE_T = 1.0
"""A channel is predicted worse where the mean squared error grows by so many standard errors,
from the spread of blocks, and the RMS by ``LEAST_SHARE``: a doubt counts against what was found,
and what does not change a prediction is no doubt."""
LEAST_BLOCKS = 3
KEPT = 4
"""Predictions of a minute take 10 MB, and a search asks for fifty."""
LEFT = 1.1
"""A channel's gap from which something is left in it: what noise floors are off by (docs). One
whose RMS grows so many times beyond what it was and beyond noise is predicted worse whatever its
blocks scatter: errors that all lie in one second (a model that believes it has left the ground)
have no standard error, and whoever flies the model meets them."""
LEAST_EXPLAINED = 0.1
"""Of the given model's squared excess over noise: what explains less of it explains nothing."""
FELL = 0.03
"""Of the gap on proof samples, the least by which it has to fall for anything to be called found:
noise floors of two flights differ by as much."""
BANDS_HZ = (0.0, 0.5, 2.0, 8.0, 30.0, 1000.0)
"""Trim and drift, translation, attitude control, rotors and filters, vibration."""


class Explained(msgspec.Struct, frozen=True):
    """What the given model got wrong on proof samples, as shares (sum 1) of its squared excess over
    noise: by what follows them it is explained, and what is left."""

    named: float
    constants: float
    disturbance: float
    left: float

    def words(self, slow: Disturbance | None) -> str:
        """The sum as a sentence."""

        def percent(share: float) -> str:
            return f"{100.0 * share:.0f} %"

        without = "" if slow is None else f" ({slow})"
        return (
            f"of what the given model got wrong, named effects explain {percent(self.named)},"
            f" changed constants {percent(self.constants)}, a slow disturbance without a name"
            f" follows {percent(self.disturbance)}{without}, {percent(self.left)} is left"
        )


@dataclass(frozen=True, slots=True)
class Proof:
    """The given and the improved model, on the samples they were fitted to and on others.

    before, after: without a disturbance; followed: (given, improved) each with its own; further:
    both without it, 200 and 500 ms ahead. steps:
    (what changed, the gap on proof samples with it): the given model, the constants that moved, if
    any did, then each effect in order. explained: None where the given model leaves no more than
    noise.
    """

    train_before: Comparison
    train_after: Comparison
    before: Comparison
    after: Comparison
    followed: tuple[Comparison, Comparison]
    further: tuple[Comparison, Comparison]
    steps: tuple[tuple[str, float], ...]
    explained: Explained | None


class Left(msgspec.Struct, frozen=True):
    """What the improved model leaves in a channel, 50 ms ahead: gap, the band (Hz) in which most of
    it lies, and that band's share of all that is beyond noise.

    words: ``gyro_x: 1.40 times noise, 80 % of the excess 0.5 to 2 Hz``.
    """

    channel: str
    gap: float
    band_hz: tuple[float, float]
    share: float
    words: str


class Predictions:
    """A given model on some rows, and others beside it; the last few are not predicted again."""

    def __init__(self, before: Comparison, every_s: float = 0.0, kept: int = KEPT) -> None:
        self.before, self._every_s, self._kept = before, every_s, kept
        self._last: dict[bytes, Comparison] = {}

    def of(self, model: Model, near: Comparison | None = None) -> Comparison:
        """Another model on the same rows. near: of one that it hardly differs from, and whose
        observer suits it."""
        key = _numbers(model)
        if key == _numbers(self.before.model):
            return self.before
        found = self._last.pop(key, None)
        if found is None:
            like = self.before if near is None else near
            found = like.with_model(model, self._every_s, near is not None)
        self._last[key] = found
        if len(self._last) > self._kept:
            del self._last[next(iter(self._last))]
        return found


class FittedRows(Predictions):
    """The same, with what decides: the gap, and the channels that are predicted worse.

    every_s: predictions start no more often than that.
    """

    def __init__(self, before: Comparison, every_s: float = 0.0) -> None:
        super().__init__(before.with_model(before.model, every_s) if every_s else before, every_s)
        self._judged: dict[bytes, Predicted] = {}

    def judge(self, model: Model) -> Predicted:
        """The gap of another model, and the channels on which it is worse than the given one."""
        key = _numbers(model)
        if key not in self._judged:
            after = self.of(model)
            gaps = tuple((after.rms / self.before.noise_floor).tolist())
            worse = worse_channels(self.before, after)
            self._judged[key] = Predicted(after.beside(self.before), worse, gaps)
        return self._judged[key]

    def squares(self, model: Model, near: Comparison | None = None) -> Array:
        """What each second adds to a model's squared gap, by channel (s, 9); NaN for a channel that
        is not there."""
        after, there = self.of(model, near), np.isfinite(self.before.rms)
        values = np.concatenate([h for one in after.errors for h in one.horizons])
        blocks = np.concatenate([_squares_by_blocks(one) for one in after.errors])
        scale = self.before.noise_floor**2 * np.isfinite(values).sum(axis=0) * there.sum()
        return np.where(there, np.nan_to_num(blocks), np.nan) / np.where(there, scale, np.nan)


def _numbers(model: Model) -> bytes:
    """All that a prediction depends on."""
    effects = sorted(
        (term.name, sorted((key, one.value) for key, one in term.parameters.items()))
        for term in model.effects
    )
    return msgspec.json.encode((model.motor, model.motors, model.body, effects, model.disturbance))


def prove(findings: Findings, train: Predictions, rows: Predictions) -> tuple[Findings, Proof]:
    """Predict proof samples with each step from the given model to the improved one; the findings
    with these gaps. They choose no name and no size, but take the word back: what they contradict
    is possible, not found (``_upheld``).

    train: the given model on the samples that were fitted; the noise floor is learnt on them, and
    is the same before and after.
    """
    before, plain = rows.before, bare(findings.model)
    after = rows.of(plain)
    findings = _upheld(findings, rows, after)
    steps = [(GIVEN, before.gap)]
    moved = bool(findings.base_changes) or findings.moved.effects != findings.base.effects
    if moved:
        steps.append((BASE, rows.of(findings.moved).beside(before)))
    first, last, effects = steps[-1][1], after.beside(before), []
    whole = first**2 - last**2 if falls(first, last) else math.nan
    for found, model in zip(findings.effects, findings.models, strict=True):
        gap = Step(steps[-1][1], rows.of(model, after).beside(before))
        share = (gap.before**2 - gap.after**2) / whole
        known = share if math.isfinite(share) else None
        effects.append(msgspec.structs.replace(found, gap=gap, weight=known))
        steps.append((found.name, gap.after))
    followed = rows.of(findings.given), rows.of(findings.model)
    alone = rows.of(_only_named(findings)).beside(before) if moved else last
    ends = before.gap, first, alone, last, followed[1].beside(before)
    far = before.further(train.before.further().black_box)
    further = far, far.with_model(plain, FURTHER_EVERY_S)
    proof = Proof(
        train.before,
        train.of(plain),
        before,
        after,
        followed,
        further,
        tuple(steps),
        explained_by(*ends) if falls(before.gap, last) else None,
    )
    fitted = train.before.gap, proof.train_after.beside(train.before)
    told = verdict_of(findings, fitted, (before.gap, last))
    return replace(findings, verdict=told, effects=tuple(effects)), proof


def verdict_of(
    findings: Findings, fitted: tuple[float, float], proven: tuple[float, float]
) -> Verdict:
    """What came of a search, by its gaps (of the given and the improved model) on the samples that
    were fitted and on those that decided nothing.

    What is left unexplained on either is said, for a push that only one flight had is missing too.
    """
    if any(_nothing_explains(findings, given, found) for given, found in (fitted, proven)):
        return Verdict.UNEXPLAINED
    within = proven[1] <= LEFT  # not where nothing tells it
    if not findings.effects:
        return Verdict.NO_DISCREPANCY if within else Verdict.UNEXPLAINED
    return Verdict.EFFECTS_FOUND if within else Verdict.FOUND_IN_PART


def _nothing_explains(findings: Findings, given: float, found: float) -> bool:
    """Whether more than noise is wrong, and what was found takes hardly any of it off or has no
    name."""
    if given <= LEFT:
        return False
    explained = (given**2 - found**2) / (given**2 - 1.0)
    nameless = not findings.effects and (found > LEFT or bool(findings.possible))
    return not explained >= LEAST_EXPLAINED or nameless


def falls(before: float, after: float) -> bool:
    """Whether a gap falls by as much as counts."""
    return after <= (1.0 - FELL) * before


def _upheld(findings: Findings, rows: Predictions, after: Comparison) -> Findings:
    """The findings without the names that proof samples contradict: all, where the gap does not
    fall, or grows where it was within noise before; those with which a channel of their own is
    predicted worse, beside the others, than without. They stay fitted along, as what is possible
    does."""
    before, last = rows.before.gap, after.beside(rows.before)
    refused: dict[str, Refusal] = {}
    if falls(before, last) or (before <= LEFT and last <= (1.0 + FELL) * before):
        refused = _contradicted(findings, after)
    else:
        words = f"prediction errors of proof samples do not fall by {100.0 * FELL:g} %"
        refused = {one.name: Refusal(Reason.WITHOUT_WEIGHT, words) for one in findings.effects}
    if not refused:
        return findings
    doubted = [one.doubted(refused[one.name]) for one in findings.effects if one.name in refused]
    terms = {term.name: term for term in findings.model.effects}
    along = (*findings.moved.effects, *(terms[one.name] for one in doubted))
    kept: list[EffectFound] = []
    models, named = [], along
    for one in findings.effects:
        if one.name not in refused:
            named = (*named, terms[one.name])
            models.append(msgspec.structs.replace(bare(findings.model), effects=named))
            kept.append(msgspec.structs.replace(one, order=len(models)))
    return replace(
        findings,
        effects=tuple(kept),
        models=tuple(models),
        possible=(*findings.possible, *doubted),
        moved=msgspec.structs.replace(findings.moved, effects=along),
        candidates=tuple(
            one.refused(refused[one.name]) if one.name in refused else one
            for one in findings.candidates
        ),
    )


def _contradicted(findings: Findings, after: Comparison) -> dict[str, Refusal]:
    """Effects with which a channel of their own is predicted worse, by name: the one that harms the
    most first, and others only where they do without it as well."""
    refused: dict[str, Refusal] = {}
    now = after.with_model(after.model, FURTHER_EVERY_S)
    while True:
        harm: dict[str, tuple[float, Comparison, str]] = {}
        for one in findings.effects:
            if one.name in refused:
                continue
            others = tuple(term for term in now.model.effects if term.name != one.name)
            model = msgspec.structs.replace(now.model, effects=others)
            without = now.with_model(model, FURTHER_EVERY_S)
            for channel in worse_channels(without, now):
                name, growth = CHANNELS[channel], float(now.rms[channel] / without.rms[channel])
                if name in one.channels and growth > harm.get(one.name, (0.0,))[0]:
                    harm[one.name] = growth, without, name
        if not harm:
            return refused
        worst = max(harm, key=lambda name: harm[name][0])
        _, now, channel_name = harm[worst]
        words = f"with it {channel_name} of proof samples is predicted worse than without"
        refused[worst] = Refusal(Reason.PREDICTS_WORSE, words)


def bare(model: Model) -> Model:
    """A model without its disturbance."""
    return msgspec.structs.replace(model, disturbance=None)


def _only_named(findings: Findings) -> Model:
    """The given model with the named effects and its own constants."""
    names = {one.name for one in findings.effects}
    given = bare(findings.base)
    added = (term for term in findings.model.effects if term.name in names)
    return msgspec.structs.replace(given, effects=(*given.effects, *added))


def explained_by(
    given: float, moved: float, named: float, both: float, followed: float
) -> Explained | None:
    """The shares, from the gaps of the given model, with other constants, with the named effects,
    with both, and with a disturbance beside them; None where nothing is to explain.

    Constants and effects make up for each other, and what comes first would be charged for the
    other's absence: each has the mean over both orders (Shapley 1953), or constants come first
    where the effects alone predict no number.
    """
    excess = given**2 - 1.0
    if given < LEFT:
        return None
    effects = moved**2 - both**2
    if math.isfinite(named):
        effects = 0.5 * (effects + given**2 - named**2)
    return Explained(
        effects / excess,
        (given**2 - both**2 - effects) / excess,
        (both**2 - followed**2) / excess,
        (followed**2 - 1.0) / excess,
    )


def worse_channels(before: Comparison, after: Comparison) -> dict[int, float]:
    """Channels that are predicted worse: number -> by how many standard errors, at least
    ``WORSE_T``; without end where the other model predicts no number at all."""
    growth = after.rms > (1.0 + LEAST_SHARE) * before.rms
    anyhow = after.rms > LEFT * np.maximum(before.rms, before.noise_floor)
    lost = np.isfinite(before.rms) & ~np.isfinite(after.rms)
    pairs = zip(before.errors, after.errors, strict=True)
    blocks = [_squares_by_blocks(other) - _squares_by_blocks(one) for one, other in pairs]
    grown = np.concatenate(blocks)
    found = dict.fromkeys(np.flatnonzero(lost).tolist(), math.inf)
    for channel in np.flatnonzero(growth).tolist():
        sums = grown[np.isfinite(grown[:, channel]), channel]
        t = 0.0
        if len(sums) >= LEAST_BLOCKS:
            t = float(sums.mean() / max(sums.std(ddof=1) / np.sqrt(len(sums)), 1e-300))
        if t > WORSE_T or anyhow[channel]:
            found[channel] = max(t, WORSE_T)
    return found


def what_is_left(after: Comparison) -> list[Left]:
    """Channels whose errors are clearly beyond noise, the worst first."""
    found = []
    ratio = after.rms / after.noise_floor
    for channel in np.flatnonzero(ratio > LEFT).tolist():
        beyond = np.zeros(len(BANDS_HZ) - 1)
        for error, floor in zip(after.errors, after.floors, strict=True):
            power = (
                _band_power(part.horizons[-1][:, channel], error.run.period_s)
                for part in (error, floor)
            )
            beyond += np.subtract(*power)
        beyond = np.maximum(beyond, 0.0)
        band = int(np.argmax(beyond))
        share = float(beyond[band] / max(beyond.sum(), 1e-300))
        low, high = BANDS_HZ[band : band + 2]
        where = f"above {low:g} Hz" if low == BANDS_HZ[-2] else f"{low:g} to {high:g} Hz"
        name, gap = CHANNELS[channel], float(ratio[channel])
        words = f"{name}: {gap:.2f} times noise, {100.0 * share:.0f} % of the excess {where}"
        found.append(Left(name, gap, (low, high), share, words))
    return sorted(found, key=lambda one: -one.gap)


def _band_power(values: Array, period_s: float) -> Array:
    """Energy of errors (n,) in each of ``BANDS_HZ``; rows that were not judged are bridged."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 2:
        return np.zeros(len(BANDS_HZ) - 1)
    rows = filled(values[known[0] : known[-1] + 1])
    power = np.abs(np.fft.rfft(rows)) ** 2 / len(rows)
    hz = np.fft.rfftfreq(len(rows), period_s)
    place = np.clip(np.searchsorted(BANDS_HZ, hz, side="right") - 1, 0, len(BANDS_HZ) - 2)
    return np.asarray(np.bincount(place, power, len(BANDS_HZ) - 1), np.float64)


def _squares_by_blocks(errors: AheadErrors) -> Array:
    """Squared errors over both horizons, summed over blocks of time, (blocks, 9); NaN where nothing
    was judged."""
    squares = np.stack(errors.horizons) ** 2
    known = np.isfinite(squares)
    rows = np.where(known, squares, 0.0).sum(axis=0)
    block = np.arange(len(rows)) * errors.run.period_s // BLOCK_S
    starts = np.flatnonzero(np.diff(block, prepend=-1.0))
    counted = np.add.reduceat(known.any(axis=0), starts, axis=0)
    return np.where(counted > 0, np.add.reduceat(rows, starts, axis=0), np.nan)


# What each name carries: how much worse fitted samples are predicted where it is left out and all
# other numbers stay.


@dataclass(frozen=True, slots=True)
class Weight:
    """share: of the given model's squared excess over noise, by what a name takes off; stderr: of
    it, from the spread of seconds. most: of what a channel that it touches is left with without it,
    the share that it takes, the largest over channels."""

    share: float
    stderr: float
    most: float

    @property
    def is_carried(self) -> bool:
        """Whether it takes enough off, and the gap is no smaller without it."""
        return self.share > 0.0 and self.most >= LEAST_SHARE

    @property
    def raises(self) -> bool:
        """Whether the gap is smaller without it by more than seconds scatter."""
        return self.share < -self.stderr


def weight(given_gap: float, now: Array, left: Array, channels: Collection[int]) -> Weight | None:
    """Of one name; None where nothing is left to explain in any channel that it touches.

    now, left: what each second adds to the squared gap with it and without, by channel (s, 9), NaN
    for one that is not there. channels: that it touches.
    """
    count = int(np.isfinite(now).any(axis=0).sum())
    with_it, without = (count * np.nansum(one, axis=0)[list(channels)] for one in (now, left))
    if not (np.maximum(with_it, without) > LEFT**2).any():
        return None
    beyond = without > LEFT**2
    most = np.max((without - with_it)[beyond] / (without[beyond] - 1.0), initial=0.0)
    seconds = np.nansum(left - now, axis=1)
    excess = max(given_gap**2, LEFT**2) - 1.0
    spread = float(seconds.std()) * len(seconds) ** 0.5
    return Weight(float(seconds.sum()) / excess, spread / excess, float(most))
