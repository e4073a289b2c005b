"""Whether an effect is believed: the gates that every name has to pass, in their order.

A gate is a question that is asked at one stage of the procedure (``search.py``), a threshold with
its source, and the reason that a refused candidate carries. Adding a gate is one function and one
line of ``GATES``, or of ``SHAKEN_GATES`` for what has no column and turns with a rotor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import TypeVar

import numpy as np

from groundstation.discrepancy.evidence import HELD_OUT_SHARE, Evidence
from groundstation.discrepancy.findings import Reason, Refusal
from groundstation.discrepancy.screening import PENALTY, Scored, beside_shapes, sizes_at
from groundstation.discrepancy.weight import Weight
from groundstation.dynamics.effect import Effect
from groundstation.dynamics.model import Estimate
from groundstation.identification.likelihood.motion import Variant, estimates_of
from groundstation.identification.likelihood.problem import Fit

Asked = TypeVar("Asked")

WORTH = 16.0
"""Drop of -2 log L in the screening that is worth a joint fit: 4 standard errors."""
LEAST_T = 4.5
"""Standard errors, from scores by blocks: about one false alarm in 100 000 trials."""
LEAST_DROP, DROP_PER_PARAMETER = 20.0, 6.0
"""The same as a drop of -2 log L for one parameter, and more for each further one: the logarithm of
some 400 independent values (Schwarz 1978)."""
LEAST_HELD_OUT = 3.0
"""Drop of -2 log L on flights that are left out: more than chance gives (95 % of chi-squared with
one degree of freedom is 3.8, for a size that is not fitted to them half of it)."""
BEYOND_SHARE = 0.5
"""Where rows do not show every setting of the motors: most of what an effect explains has to be
more than the others can do."""
LEAST_SURE = 3.0
"""Of its standard errors, what flights differ by among them, by which a size is away from none: an
interval of 99.7 % does not hold it."""
LEAST_RECURRENCE = 0.6
"""Of the resamples in which a name has to be chosen: the least that Meinshausen and Buehlmann
(2010) recommend. Below, it is possible: fitted along, told, and not named."""
KEEP = 14.0
"""An accepted effect whose removal costs less than this leaves: 3.7 standard errors, below what it
took to join so that nothing joins and leaves in turn."""
DISAGREE, APART_SHARE = 5.0, 0.4
"""Flights disagree on how much a rotor shakes where the size in one lies so many standard errors
and this share of it away."""


class Stage(Enum):
    """Where in the procedure a gate stands."""

    SCREENED = auto()
    """The columns of every effect are known."""
    WEIGHED = auto()
    """Its evidence has been gathered, on flights that are left out too; asked again in the end,
    beside all that joined since."""
    JOINED = auto()
    """Another effect has joined since."""
    NAMED = auto()
    """The last one."""


@dataclass(slots=True)
class Trial:
    """A candidate on its way through the gates; each stage fills in what it found.

    fit: of base, accepted effects and this one. gain: what -2 log L lost by it, less the penalty.
    removal: what -2 log L gains when it leaves. open_s: delay that the rows leave open. recurrence:
    share of resamples that choose it. errors: standard errors by key, with what flights differ by.
    weight: what it carries in predictions, None where nothing
    is left to explain.
    """

    variant: Variant
    fit: Fit | None = None
    gain: float = 0.0
    evidence: Evidence | None = None
    removal: float = np.inf
    open_s: float = 0.0
    recurrence: float = 1.0
    errors: Mapping[str, float] = field(default_factory=dict)
    weight: Weight | None = None
    scored: Scored | None = None


@dataclass(frozen=True, slots=True)
class Shaken:
    """A rotor that shakes the craft, on its way through its gates.

    t: standard errors by which its power is above none; alone: by which it is above that of the
    three others together. drop: of -2 log L of the windows' spectra. recordings: standard errors
    and share by which one flight tells another size. channels: that show it.
    """

    effect: Effect
    parameters: Mapping[str, Estimate]
    t: float
    drop: float
    alone: float
    recordings: tuple[float, float]
    channels: tuple[int, ...]


def weak(trial: Trial) -> str:
    """The screening promises too little."""
    assert trial.scored is not None
    most = WORTH + PENALTY * (len(trial.variant.keys) - 1)
    return "no significant improvement" if trial.scored.drop < most else ""


def wrong_sign(trial: Trial) -> str:
    """A one-sided size points to the wrong side."""
    variant = trial.variant
    assert trial.scored is not None
    if len(variant.sizes) > 1:
        return ""
    size = variant.unknowns[0]
    possible = size.plausible[0] < 0 or trial.scored.values[0] + size.absent > 0
    return "" if possible else "fits only with a sign that physics does not allow"


def implausible(trial: Trial) -> str:
    """No small craft has such a size, or it lies where the search ends."""
    assert trial.fit is not None
    point = trial.fit.point
    ends = any(
        point.get(u.key, u.absent) in {*u.bounds} - {u.absent} for u in trial.variant.unknowns
    )
    if not ends and plausible(trial.variant, point):
        return ""
    return f"not plausible: {_in_words(estimates_of(trial.variant, point, {}))}"


def insignificant(trial: Trial) -> str:
    """Chance can do it."""
    evidence = _evidence(trial)
    least = LEAST_DROP + DROP_PER_PARAMETER * (len(trial.variant.keys) - 1)
    enough = evidence.drop >= least and evidence.t >= LEAST_T
    return "" if enough else f"not significant: {evidence.t:.1f} standard errors"


def not_held_out(trial: Trial) -> str:
    """Flights that its size was not taken from are not explained better."""
    evidence = _evidence(trial)
    enough = evidence.held_out >= max(LEAST_HELD_OUT, HELD_OUT_SHARE * evidence.expected)
    return "" if enough else "flights that its size was not taken from are not explained better"


def unseen_settings(trial: Trial) -> str:
    """What the motors did between rows can do as much, and nobody knows what that was.

    A delay is fitted along in any case, for left out it bends the constants, and is asked by
    ``negligible``.
    """
    evidence = _evidence(trial)
    if trial.variant.definition.stage == "delay" or evidence.beyond >= max(
        LEAST_DROP, BEYOND_SHARE * evidence.drop
    ):
        return ""
    return (
        "rows hold several settings of the motors and show one: the others can do as much; log"
        " faster"
    )


def superfluous(trial: Trial) -> str:
    """The others do as well without it."""
    return "superfluous once another effect had joined" if trial.removal < KEEP else ""


def negligible(trial: Trial) -> str:
    """It is surely there, and always is: too small to be called an effect."""
    assert trial.fit is not None
    effect, point = trial.variant.definition, trial.fit.point
    size = float(np.linalg.norm(sizes_at(trial.variant, point)))
    fitted = f"{_in_words(estimates_of(trial.variant, point, {}))} fitted, but no effect"
    if effect.stage == "delay" and size < trial.open_s:
        return (
            f"{fitted}: the controller answers several times within a row, which leaves a delay"
            f" below {1e3 * trial.open_s:.2g} ms open"
        )
    return f"{fitted}: {effect.because}" if size < effect.negligible else ""


def not_recurrent(trial: Trial) -> str:
    """Other stretches and flights would choose others."""
    if trial.recurrence >= LEAST_RECURRENCE:
        return ""
    assert trial.fit is not None
    fitted = _in_words(estimates_of(trial.variant, trial.fit.point, {}))
    return f"possible: {fitted} fitted, chosen in {100.0 * trial.recurrence:.0f} % of resamples"


def flights_differ(trial: Trial) -> str:
    """From flight to flight it differs by as much as it is large."""
    assert trial.fit is not None
    sizes = sizes_at(trial.variant, trial.fit.point)
    keys, covariance = trial.fit.keys, trial.fit.covariance
    own = [keys.index(key) for key in trial.variant.sizes]
    beside = np.diag(beside_shapes(trial.variant, keys, covariance))
    stated = np.array([trial.errors.get(key, 0.0) for key in trial.variant.sizes])
    more = np.maximum(stated**2 - covariance[own, own], 0.0)
    errors = np.where(stated > 0.0, np.sqrt(beside + more), 0.0)
    if (np.abs(sizes) >= LEAST_SURE * errors).any():
        return ""
    fitted = _in_words(estimates_of(trial.variant, trial.fit.point, {}))
    return f"possible: {fitted} fitted, but stretches and flights differ by nearly as much"


def without_weight(trial: Trial) -> str:
    """Predictions are hardly better with it, where something is left to explain."""
    if trial.weight is None or trial.weight.is_carried:
        return ""
    assert trial.fit is not None
    fitted = _in_words(estimates_of(trial.variant, trial.fit.point, {}))
    less = "no lower" if trial.weight.share <= 0.0 else "hardly lower"
    return f"possible: {fitted} fitted, and prediction errors of fitted samples {less} with it"


def is_significant(t: float, drop: float) -> bool:
    """Whether chance hardly does it: standard errors, and the drop of -2 log L, of one variance."""
    return t >= LEAST_T and drop >= LEAST_DROP


def chance_shakes(shaken: Shaken) -> str:
    """Windows of spectra agree no better by chance."""
    enough = is_significant(shaken.t, shaken.drop)
    return "" if enough else f"not significant: {shaken.t:.1f} standard errors"


def implausible_shaking(shaken: Shaken) -> str:
    """No rotor shakes a small craft so."""
    if shaken.effect.plausible({name: one.value for name, one in shaken.parameters.items()}):
        return ""
    return f"not plausible: {_in_words(shaken.parameters)}"


def shakes_no_more(shaken: Shaken) -> str:
    """Every propeller is a little out of balance."""
    if shaken.alone >= LEAST_T:
        return ""
    return (
        f"{_in_words(shaken.parameters)} shakes most, but not clearly more than the three others"
        f" together: {shaken.alone:.1f} standard errors"
    )


def rotors_disagree(shaken: Shaken) -> str:
    """Flights tell different sizes."""
    errors, share = shaken.recordings
    if errors <= DISAGREE or share <= APART_SHARE:
        return ""
    return f"recordings disagree on its size by {errors:.0f} standard errors"


GATES: tuple[tuple[tuple[Stage, ...], Reason, Callable[[Trial], str]], ...] = (
    ((Stage.SCREENED,), Reason.WEAK, weak),
    ((Stage.SCREENED,), Reason.WRONG_SIGN, wrong_sign),
    ((Stage.WEIGHED,), Reason.IMPLAUSIBLE, implausible),
    ((Stage.WEIGHED,), Reason.INSIGNIFICANT, insignificant),
    ((Stage.WEIGHED,), Reason.NOT_HELD_OUT, not_held_out),
    ((Stage.WEIGHED,), Reason.BETWEEN_ROWS, unseen_settings),
    ((Stage.JOINED,), Reason.SUPERFLUOUS, superfluous),
    ((Stage.NAMED,), Reason.NEGLIGIBLE, negligible),
    ((Stage.NAMED,), Reason.RECORDINGS_DISAGREE, flights_differ),
    ((Stage.NAMED,), Reason.NOT_RECURRENT, not_recurrent),
    ((Stage.NAMED,), Reason.WITHOUT_WEIGHT, without_weight),
)
"""When a gate is asked, the reason it gives, and the question; each returns words, or nothing."""
SHAKEN_GATES: tuple[tuple[Reason, Callable[[Shaken], str]], ...] = (
    (Reason.INSIGNIFICANT, chance_shakes),
    (Reason.NOT_ALONE, shakes_no_more),
    (Reason.RECORDINGS_DISAGREE, rotors_disagree),
    (Reason.IMPLAUSIBLE, implausible_shaking),
)
"""The same for what turns with a rotor, asked once."""


def refusal(stage: Stage, trial: Trial) -> Refusal | None:
    """Why a candidate does not pass a stage; None where it does."""
    asked = ((reason, question) for where, reason, question in GATES if stage in where)
    return _first(asked, trial)


def shaken_refusal(shaken: Shaken) -> Refusal | None:
    """The same of what turns with a rotor."""
    return _first(SHAKEN_GATES, shaken)


def _first(gates: Iterable[tuple[Reason, Callable[[Asked], str]]], asked: Asked) -> Refusal | None:
    return next(
        (Refusal(why, words) for why, question in gates if (words := question(asked))), None
    )


def _in_words(parameters: Mapping[str, Estimate]) -> str:
    return ", ".join(f"{k} {one.value:.3g} {one.unit}".strip() for k, one in parameters.items())


def plausible(variant: Variant, point: Mapping[str, float]) -> bool:
    """Whether the values are ones that a small craft can have."""
    values = estimates_of(variant, point, {})
    return variant.definition.plausible({k: e.value for k, e in values.items()})


def _evidence(trial: Trial) -> Evidence:
    assert trial.evidence is not None
    return trial.evidence
