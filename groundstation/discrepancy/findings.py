"""What a search for missing effects found: the dataclasses that reports and commands read.

``find_discrepancy`` in ``engine.py`` makes it. Everything in it is plain numbers in the units of
the model file, so that a report needs no knowledge of how it was found.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

import msgspec

from groundstation.comparison.gap import CHANNELS
from groundstation.dynamics.effect import Effect
from groundstation.dynamics.model import EffectTerm, Estimate, Model


class Verdict(StrEnum):
    """The outcome in one word, as in the report's JSON."""

    EFFECTS_FOUND = "effects_found"
    """At least one named effect passed every test."""
    NO_DISCREPANCY = "no_discrepancy"
    """Nothing is left to explain that these recordings could show."""
    UNEXPLAINED = "unexplained"
    """Residuals are structured and no known effect fits them."""


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


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """An accepted effect.

    order: 1 for the first one accepted. parameters: by name, in the model file's units, from
    the last joint fit. evidence: ``likelihood_ratio`` (drop of -2 log L when it joined), ``t``
    (from scores summed over blocks of time), ``held_out`` (drop of -2 log L on flights that its
    size was not taken from) and ``held_out_expected`` (of one that has the fitted size there);
    ``over_others``: standard errors by which a rotor shakes more than the others together.
    model: final constants, with the effects up to this one. recurrence: share of resamples that
    choose it; NaN where none were drawn. adds: its law in words. gap_before, gap_after: of
    predictions of proof samples over all channels; NaN until it is proven. weight: its share of
    what all names explain there.
    """

    name: str
    order: int
    parameters: dict[str, Estimate]
    evidence: dict[str, float]
    alternatives: tuple[Alternative, ...]
    channels: tuple[str, ...]
    model: Model
    recurrence: float = math.nan
    adds: str = ""
    gap_before: float = math.nan
    gap_after: float = math.nan
    weight: float = math.nan
    refused: Refusal | None = None


@dataclass(frozen=True, slots=True)
class Candidate:
    """What came of one effect, accepted or not.

    score: drop of -2 log L when it alone joins the base (screening). t: its largest
    parameter over its standard error. held_out: drop of -2 log L on flights that its size was not
    taken from, in the last round it took part in. refused: why it is not named, None where it is.
    """

    name: str
    parameters: dict[str, Estimate]
    score: float
    t: float
    held_out: float
    accepted: bool
    refused: Refusal | None = None


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


@dataclass(frozen=True, slots=True)
class BaseChange:
    """A constant of the given model that the search changed: name and unit as in the model file.

    stderr: of the new value. percent: of the given one, None where that is zero. pushed: by how
    many per cent the rotors, as modelled, push more at the same PWM; None: by as much.
    """

    name: str
    given: float
    value: float
    stderr: float | None
    percent: float | None
    pushed: float | None = None


@dataclass(frozen=True, slots=True)
class Leftover:
    """What is left after the last accepted effect.

    verdict: ``white`` or ``structured``. channel: the worst one. frequencies_hz: where its
    residual rises above coloured noise. signal: the strongest generic signal in it, in words.
    excess: residual over expected power of that channel where it is worst.
    """

    verdict: str
    channel: str = ""
    frequencies_hz: tuple[float, ...] = ()
    signal: str = ""
    excess: float = 1.0


@dataclass(frozen=True, slots=True)
class Findings:
    """The outcome of ``find_effects``.

    effects: accepted, in order. possible: fitted along, and too doubtful to be named. base: the
    model as it was given; given: the same with the disturbance that it leaves.
    base_changes: constants of it that moved; those that these data cannot improve have not. moved:
    the given model with these changes and with what is fitted and has no name. model: moved
    constants and effects, fitted jointly, and the disturbance that is left. candidates: every
    effect, strongest first. not_shown: excitation check. lost: effect name -> the channel that is
    missing to show it. warnings: in words.
    """

    verdict: Verdict
    effects: tuple[FoundEffect, ...]
    base: Model
    given: Model
    moved: Model
    model: Model
    base_changes: tuple[BaseChange, ...]
    candidates: tuple[Candidate, ...]
    not_shown: tuple[NotShown, ...]
    lost: dict[str, str]
    residual: Leftover
    warnings: tuple[str, ...] = field(default=())
    possible: tuple[FoundEffect, ...] = ()


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


def with_last(
    findings: Findings,
    effect: Effect,
    parameters: Mapping[str, Estimate],
    evidence: dict[str, float],
    channels: Iterable[int],
) -> Findings:
    """The findings with one effect more, the last, beside which all others stay as they are."""
    known = dict(parameters)
    effects = (*findings.model.effects, EffectTerm(effect.name, known))
    model = msgspec.structs.replace(findings.model, effects=effects)
    found = FoundEffect(
        name=effect.name,
        order=len(findings.effects) + 1,
        parameters=known,
        evidence=evidence,
        alternatives=(),
        channels=tuple(CHANNELS[c] for c in channels),
        adds=effect.adds,
        model=model,
    )
    return replace(
        findings,
        verdict=Verdict.EFFECTS_FOUND,
        effects=(*findings.effects, found),
        model=model,
    )
