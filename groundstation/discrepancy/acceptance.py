"""Which names are accepted, and which constants of the given model are fitted along."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from groundstation.discrepancy.proof import Changed, Reason, Refusal, Weight
from groundstation.discrepancy.screening import (
    HELD_OUT_SHARE,
    PENALTY,
    Evidence,
    Parts,
    Scored,
    beside_shapes,
    cross_validated,
    removal_cost,
    sizes_at,
)
from groundstation.dynamics.effect import Effect
from groundstation.dynamics.model import Estimate
from groundstation.dynamics.registry import ROTORS_TURN_BY
from groundstation.identification.body_setup import (
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
from groundstation.identification.likelihood.problem import (
    Fit,
    Problem,
    bounded,
    unfitted,
)
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

# Whether an effect is believed. In the order in which a name can be lost:
#
# 1. ``SCREENED``: it explains enough of the residual, alone, to be worth a joint fit;
# 2. ``WEIGHED``: it does beside what is there already, on flights that are left out as well
#    (``search.failing`` asks it again of all that joined);
# 3. ``JOINED``: it keeps that in the joint fit (``search.drop_needless`` drops it otherwise);
# 4. ``search.answer_to_predictions``: with it fitted samples are not predicted worse;
# 5. ``NAMED``: its size is sure and recurs; one that fails here is possible, and not named, or
#    dropped where it is negligible (``engine.conclude``);
# 6. ``proof``: flights that no choice has seen do not contradict it.
#
# ``SHAKEN`` is asked of a propeller's imbalance, which has no column, by ``disturbances.py``; a
# sensor's lag is asked by ``engine.add_sensor_lag``.
#
# A gate is a question that is asked at one stage of the procedure (``search.py``), a threshold with
# its source, and the reason that a refused candidate carries. Adding a gate is one function and one
# line of one of these tables; a reason of its own stands in ``proof.Reason``, its words in
# ``report.DOUBTS``, a threshold in docs/method.md.


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


@dataclass(frozen=True, slots=True)
class Last:
    """An effect of the last joint fit before its last gates.

    open_s: delay that the rows leave open. recurrence: share of resamples that choose it. errors:
    standard errors by key, with what flights differ by. weight: what it carries in predictions,
    None where nothing is left to explain.
    """

    variant: Variant
    fit: Fit
    open_s: float = 0.0
    recurrence: float = 1.0
    errors: Mapping[str, float] = field(default_factory=dict)
    weight: Weight | None = None

    @property
    def fitted(self) -> str:
        return _fitted(self.variant, self.fit.point)


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


def weak(one: Scored) -> str:
    """The screening promises too little."""
    most = WORTH + PENALTY * (len(one.variant.keys) - 1)
    return "no significant improvement" if one.drop < most else ""


def wrong_sign(one: Scored) -> str:
    """A one-sided size points to the wrong side."""
    size = one.variant.unknowns[0]
    several = len(one.variant.sizes) > 1
    if several or size.plausible[0] < 0 or one.values[0] + size.absent > 0:
        return ""
    return "fits only with a sign that physics does not allow"


def implausible(one: Evidence) -> str:
    """No small craft has such a size, or it lies where the search ends."""
    point = one.point
    ends = any(point.get(u.key, u.absent) in {*u.bounds} - {u.absent} for u in one.variant.unknowns)
    if not ends and plausible(one.variant, point):
        return ""
    return f"not plausible: {_fitted(one.variant, point)}"


def insignificant(one: Evidence) -> str:
    """Chance can do it."""
    least = LEAST_DROP + DROP_PER_PARAMETER * (len(one.variant.keys) - 1)
    enough = one.drop >= least and one.t >= LEAST_T
    return "" if enough else f"not significant: {one.t:.1f} standard errors"


def not_held_out(one: Evidence) -> str:
    """Flights that its size was not taken from are not explained better."""
    enough = one.held_out >= max(LEAST_HELD_OUT, HELD_OUT_SHARE * one.expected)
    return "" if enough else "flights that its size was not taken from are not explained better"


def unseen_settings(one: Evidence) -> str:
    """What the motors did between rows can do as much, and nobody knows what that was.

    A delay is fitted along in any case, for left out it bends the constants, and is asked by
    ``negligible``.
    """
    least = max(LEAST_DROP, BEYOND_SHARE * one.drop)
    if one.variant.definition.stage == "delay" or one.beyond >= least:
        return ""
    return (
        "rows hold several settings of the motors and show one: the others can do as much; log"
        " faster"
    )


def superfluous(removal: float) -> str:
    """The others do as well without it. removal: what -2 log L gains when it leaves."""
    return "superfluous once another effect had joined" if removal < KEEP else ""


def negligible(one: Last) -> str:
    """It is surely there, and always is: too small to be called an effect."""
    effect, size = one.variant.definition, float(np.linalg.norm(_sizes(one)))
    if effect.stage == "delay" and size < one.open_s:
        return (
            f"{one.fitted} fitted, but no effect: the controller answers several times within a"
            f" row, which leaves a delay below {1e3 * one.open_s:.2g} ms open"
        )
    small = size < effect.negligible
    return f"{one.fitted} fitted, but no effect: {effect.because}" if small else ""


def flights_differ(one: Last) -> str:
    """From flight to flight it differs by as much as it is large."""
    keys, covariance = one.fit.keys, one.fit.covariance
    own = [keys.index(key) for key in one.variant.sizes]
    beside = np.diag(beside_shapes(one.variant, keys, covariance))
    stated = np.array([one.errors.get(key, 0.0) for key in one.variant.sizes])
    more = np.maximum(stated**2 - covariance[own, own], 0.0)
    errors = np.where(stated > 0.0, np.sqrt(beside + more), 0.0)
    if (np.abs(_sizes(one)) >= LEAST_SURE * errors).any():
        return ""
    return f"possible: {one.fitted} fitted, but stretches and flights differ by nearly as much"


def not_recurrent(one: Last) -> str:
    """Other stretches and flights would choose others."""
    if one.recurrence >= LEAST_RECURRENCE:
        return ""
    return f"possible: {one.fitted} fitted, chosen in {100.0 * one.recurrence:.0f} % of resamples"


def without_weight(one: Last) -> str:
    """Predictions are hardly better with it, where something is left to explain."""
    if one.weight is None or one.weight.is_carried:
        return ""
    less = "no lower" if one.weight.share <= 0.0 else "hardly lower"
    return f"possible: {one.fitted} fitted, and prediction errors of fitted samples {less} with it"


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


Gates = tuple[tuple[Reason, Callable[[Asked], str]], ...]
"""The reason that a gate gives, and its question, which returns words, or nothing."""
SCREENED: Gates[Scored] = ((Reason.WEAK, weak), (Reason.WRONG_SIGN, wrong_sign))
"""Asked once the columns of every effect are known."""
WEIGHED: Gates[Evidence] = (
    (Reason.IMPLAUSIBLE, implausible),
    (Reason.INSIGNIFICANT, insignificant),
    (Reason.NOT_HELD_OUT, not_held_out),
    (Reason.BETWEEN_ROWS, unseen_settings),
)
"""Asked of its evidence, on flights that are left out too; again in the end, beside all that joined
since."""
JOINED: Gates[float] = ((Reason.SUPERFLUOUS, superfluous),)
"""Asked when another effect has joined since."""
NAMED: Gates[Last] = (
    (Reason.NEGLIGIBLE, negligible),
    (Reason.RECORDINGS_DISAGREE, flights_differ),
    (Reason.NOT_RECURRENT, not_recurrent),
    (Reason.WITHOUT_WEIGHT, without_weight),
)
"""The last ones."""
SHAKEN: Gates[Shaken] = (
    (Reason.INSIGNIFICANT, chance_shakes),
    (Reason.NOT_ALONE, shakes_no_more),
    (Reason.RECORDINGS_DISAGREE, rotors_disagree),
    (Reason.IMPLAUSIBLE, implausible_shaking),
)
"""Of what turns with a rotor, asked once."""


def refusal(gates: Gates[Asked], asked: Asked) -> Refusal | None:
    """Why a candidate does not pass a stage; None where it does."""
    return next(
        (Refusal(why, words) for why, question in gates if (words := question(asked))), None
    )


def _in_words(parameters: Mapping[str, Estimate]) -> str:
    return ", ".join(f"{k} {one.value:.3g} {one.unit}".strip() for k, one in parameters.items())


def _fitted(variant: Variant, point: Point) -> str:
    return _in_words(estimates_of(variant, point, {}))


def _sizes(one: Last) -> Array:
    return sizes_at(one.variant, one.fit.point)


def plausible(variant: Variant, point: Mapping[str, float]) -> bool:
    """Whether the values are ones that a small craft can have."""
    values = estimates_of(variant, point, {})
    return variant.definition.plausible({k: e.value for k, e in values.items()})


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
"""Channels (0..8 as in ``gap.CHANNELS``) that a constant moves first; others move all."""


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
        gain, _ = cross_validated(linear, Parts.of(problem, linear), group, away)
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
    plain = problem.plain(point, (), problem.flights)
    own = replace(plain, spectra=[s for s in plain.spectra if s.channel == axis])
    return unfitted(own.within(*band))[2]


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
) -> tuple[Changed, ...]:
    """The constants among ``keys`` that moved to ``final``, what effects are other names of
    (``renames``) included. errors: standard errors by key.
    """
    found = []
    for key in keys:
        given, now = problem.start.get(key, absent(key)), final.get(key, absent(key))
        if given != now:
            percent, stderr = None, errors.get(key)
            words = f"{key} {given:.4g} -> {now:.4g}"
            if given:
                percent = 100.0 * (now / given - 1.0)
                pushed = _pushed(problem, fit.point, percent) if key == THRUST else None
                spread = "" if stderr is None else f" +- {_short(100.0 * stderr / abs(given))}"
                words = f"{key} {_short(percent, sign=True)} %{spread}"
                words += _meaning(key, percent, now / given, pushed)
            found.append(Changed(key, given, now, stderr, percent, words))
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


def _meaning(key: str, percent: float, times: float, pushed: float | None) -> str:
    """What a change of a constant may mean. pushed: by how many per cent the rotors, as modelled,
    push more at the same PWM; None: by as much as the constant says."""
    if pushed is not None:
        how = f"{_short(abs(pushed))} % {'more' if pushed > 0.0 else 'less'}"
        if abs(pushed) < SAME_PERCENT:
            how = "as much as before"
        return f" with rotors of other speeds: at the same PWM they push the craft {how}"
    if key == THRUST:
        heavier = 100.0 * (1.0 / times - 1.0)
        if heavier > 0.0:
            return f": the craft is {_short(heavier)} % heavier or its rotors weaker"
        return f": the craft is {_short(-heavier)} % lighter or its rotors stronger"
    axis = {"c0": "roll", "c1": "pitch", "c2": "yaw"}.get(key)
    if axis is None:
        return ""
    how = "more" if percent > 0 else "less"
    why = "drag of the rotors" if axis == "yaw" else "thrust of the rotors or their distance"
    return f": {axis} answers {how} to its torque (inertia, {why})"


def _short(value: float, sign: bool = False) -> str:
    """Two figures, or all of those before the point."""
    text = f"{value:.0f}" if abs(value) >= 9.95 else f"{value:.2g}"
    return f"+{text}" if sign and value > 0 else text
