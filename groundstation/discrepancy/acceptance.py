"""Which names are accepted, and which constants of the given model are fitted along."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import TypeVar

import numpy as np

from groundstation.discrepancy.proof import BaseChange, Reason, Refusal, Weight
from groundstation.discrepancy.screening import (
    HELD_OUT_SHARE,
    PENALTY,
    Evidence,
    Scored,
    beside_shapes,
    cross_validated,
    removal_cost,
    sizes_at,
)
from groundstation.dynamics.effect import Effect
from groundstation.dynamics.model import Estimate
from groundstation.dynamics.registry import ROTORS_TURN_BY
from groundstation.identification.body.setup import (
    DRAG_HZ,
    GAINS,
    STEERED_HZ,
    YAW_BANDS,
    blurred,
    unseen,
)
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.evaluation import ACCELEROMETER, evaluate
from groundstation.identification.likelihood.motion import (
    BODY_KEYS,
    MOTOR_KEYS,
    Point,
    Variant,
    absent,
    estimates_of,
)
from groundstation.identification.likelihood.problem import Fit, Problem, bounded
from groundstation.identification.likelihood.spectra import linearise, unfitted
from groundstation.telemetry.packet import STANDARD_GRAVITY

# Whether an effect is believed: the gates that every name has to pass, in their order.
#
# A gate is a question that is asked at one stage of the procedure (``search.py``), a threshold with
# its source, and the reason that a refused candidate carries. Adding a gate is one function and one
# line of ``GATES``, or of ``SHAKEN_GATES`` for what has no column and turns with a rotor.


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


# The constants that the given model had already: which of them data improve, and what changed.


Group = tuple[str, ...]
"""Constants that change or stay together."""

THRUST = "thrust_per_mass"
EVERY_HZ, YAW_ENDS_HZ = (0.0, math.inf), (DRAG_HZ, YAW_BANDS[0])
SAME_PERCENT = 1.0
"""What a change of thrust per mass and one of the push at the same PWM differ by at most."""
TOUCHES: dict[str, tuple[int, ...]] = {
    "c0": (0, 6),
    "c1": (1, 7),
    "c2": (2, 8),
    THRUST: (5,),
}
"""Channels (0..8 as in ``comparison.channels``) that a constant moves first; others move all."""


def groups(start: Point, known: Sequence[Group]) -> list[Group]:
    """Each constant of the body, the motor's, and those of each effect that a model has already."""
    motor = tuple(key for key in MOTOR_KEYS if start[key] != 0.0)
    return [*((key,) for key in BODY_KEYS), motor, *known]


def not_improved(
    problem: Problem, free: Fit, every: Sequence[Group], folds: Sequence[Flight]
) -> tuple[set[str], Point]:
    """The constants that these data do not improve, and where the others move without them.

    One stays as it was given where going back costs as little as an effect that leaves, or where
    flights that the change was not taken from are explained no better with it (``folds``: each left
    out once). free: the joint fit.
    """
    held: set[str] = set()
    rest, left = free, list(every)
    while left:
        group = min(left, key=lambda one: _cost_of_going_back(rest, one, problem.start))
        if _cost_of_going_back(rest, group, problem.start) >= KEEP:
            break
        rest = _gone_back(rest, group, problem.start)
        held.update(group)
        left.remove(group)
    for group in left if folds else ():
        linear = problem.linear(rest.point, rest.keys, folds)
        away = np.array([rest.point[k] - problem.start.get(k, absent(k)) for k in group])
        gain, _ = cross_validated(problem, linear, group, away)
        if gain < LEAST_HELD_OUT:
            rest = _gone_back(rest, group, problem.start)
            held.update(group)
    return held, rest.point


def unconfirmed(problem: Problem, fit: Fit) -> Group | None:
    """Of c0, c1 and c2 the one whose change the rates about its axis speak for least, where that
    is less than keeps an effect; None where all changes stand.

    They are asked as the body's fit asks them, with noise that is free at every frequency, and
    roll and pitch in ``STEERED_HZ`` alone where the rotors' speed is not told above: what the
    search has no name for bends a constant otherwise. Slow moments of the air bend c2 at one end of
    the spectrum and the phase of the rotors' acceleration at the other, so neither end may speak
    against it.
    """
    found: list[tuple[float, str]] = []
    told = not (blurred(problem.flights) or unseen(problem.flights))
    gains_hz = EVERY_HZ if told else STEERED_HZ
    for axis, key in enumerate(BODY_KEYS[:3]):
        if key in fit.keys and fit.point[key] != problem.start[key]:
            bands = (gains_hz,) if key in GAINS else (EVERY_HZ, *YAW_ENDS_HZ)
            every, *ends = (confirmation(problem, fit.point, axis, band) for band in bands)
            against = [gain + 2.0 * KEEP for gain in ends]  # as little as that if it costs KEEP
            found.append((min([every, *against]), key))
    gain, key = min(found, default=(KEEP, ""))
    return (key,) if gain < KEEP else None


def confirmation(problem: Problem, point: Point, axis: int, band: tuple[float, float]) -> float:
    """What -2 log L of the rates about an axis, in a band (Hz), rises by with its constant as
    given."""
    back = {**point, BODY_KEYS[axis]: problem.start[BODY_KEYS[axis]]}
    return _free_cost(problem, back, axis, band) - _free_cost(problem, point, axis, band)


def _free_cost(problem: Problem, point: Point, axis: int, band: tuple[float, float]) -> float:
    """-2 log L of the rates about an axis in a band (Hz), each flight's spectrum at its best."""
    return unfitted(linearise(problem.flights, problem.frame, point, (), (axis,)).within(*band))[2]


def _cost_of_going_back(fit: Fit, group: Group, start: Point) -> float:
    own = [fit.keys.index(key) for key in group]
    away = np.array([fit.point[key] - start.get(key, absent(key)) for key in group])
    return removal_cost(away, fit.covariance[np.ix_(own, own)])


def _gone_back(fit: Fit, group: Group, start: Point) -> Fit:
    """The fit with constants as given, the others following to first order."""
    own = [fit.keys.index(key) for key in group]
    rest = [i for i in range(len(fit.keys)) if i not in own]
    away = np.array([start.get(key, absent(key)) - fit.point[key] for key in group])
    gain = fit.covariance[np.ix_(rest, own)] @ np.linalg.pinv(fit.covariance[np.ix_(own, own)])
    keys = tuple(fit.keys[i] for i in rest)
    point = bounded(fit.point, keys, gain @ away)
    point |= {key: start.get(key, absent(key)) for key in group}
    covariance = fit.covariance[np.ix_(rest, rest)] - gain @ fit.covariance[np.ix_(own, rest)]
    return Fit(point, keys, fit.cost, covariance)


def base_changes(
    problem: Problem, fit: Fit, final: Point, errors: Mapping[str, float], keys: Sequence[str]
) -> tuple[BaseChange, ...]:
    """The constants among ``keys`` that moved to ``final``, what effects are other names of
    (``renames``) included. errors: standard errors by key.
    """
    found = []
    for key in keys:
        given, now = problem.start.get(key, absent(key)), final.get(key, absent(key))
        if given != now:
            percent = 100.0 * (now / given - 1.0) if given else None
            pushed = None
            if key == THRUST and percent is not None:
                pushed = _pushed(problem, fit.point, percent)
            found.append(BaseChange(key, given, now, errors.get(key), percent, pushed))
    return tuple(found)


def _turn_otherwise(problem: Problem, final: Point) -> bool:
    """Whether rotors turn at other speeds by the same PWM: their constants moved, or an effect of
    supply or motors came."""
    unknowns = problem.frame.unknowns
    return any(
        now != problem.start.get(key, absent(key))
        and (
            key in MOTOR_KEYS or (key in unknowns and unknowns[key].effect.stage in ROTORS_TURN_BY)
        )
        for key, now in final.items()
    )


def _pushed(problem: Problem, final: Point, percent: float) -> float | None:
    """By how many per cent the mean vertical force that a model makes of the flights is another
    than the given model's; None where rotor speeds are measured, nothing tells the vertical, or
    thrust per mass, which changed by ``percent``, says the same."""
    if not _turn_otherwise(problem, final):
        return None
    ratios = []
    for flight in problem.flights:
        if not flight.rotor_measured:
            ends = (
                evaluate(flight, problem.frame, point, (), (ACCELEROMETER + 2,)).lift
                for point in (problem.start, final)
            )
            given, now = (STANDARD_GRAVITY - one[0] if one else None for one in ends)
            if given and now:
                ratios.append(now / given)
    pushed = 100.0 * (float(np.mean(ratios)) - 1.0) if ratios else math.nan
    return pushed if abs(pushed - percent) >= SAME_PERCENT else None


def in_words(change: BaseChange) -> str:
    """A change, and what it may mean."""
    if change.percent is None:
        return f"{change.name} {change.given:.4g} -> {change.value:.4g}"
    spread = ""
    if change.stderr is not None:
        spread = f" +- {_short(100.0 * change.stderr / abs(change.given))}"
    return f"{change.name} {_short(change.percent, sign=True)} %{spread}{_meaning(change)}"


def _meaning(change: BaseChange) -> str:
    if change.pushed is not None:
        how = f"{_short(abs(change.pushed))} % {'more' if change.pushed > 0.0 else 'less'}"
        if abs(change.pushed) < SAME_PERCENT:
            how = "as much as before"
        return f" with rotors of other speeds: at the same PWM they push the craft {how}"
    if change.name == THRUST:
        heavier = 100.0 * (change.given / change.value - 1.0)
        if heavier > 0.0:
            return f": the craft is {_short(heavier)} % heavier or its rotors weaker"
        return f": the craft is {_short(-heavier)} % lighter or its rotors stronger"
    axis = {"c0": "roll", "c1": "pitch", "c2": "yaw"}.get(change.name)
    if axis is None:
        return ""
    assert change.percent is not None
    how = "more" if change.percent > 0 else "less"
    why = "drag of the rotors" if axis == "yaw" else "thrust of the rotors or their distance"
    return f": {axis} answers {how} to its torque (inertia, {why})"


def _short(value: float, sign: bool = False) -> str:
    """Two figures, or all of those before the point."""
    text = f"{value:.0f}" if abs(value) >= 9.95 else f"{value:.2g}"
    return f"+{text}" if sign and value > 0 else text
