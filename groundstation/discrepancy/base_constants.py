"""The constants that the given model had already: which of them data improve, and what changed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from groundstation.discrepancy.acceptance import KEEP, LEAST_HELD_OUT
from groundstation.discrepancy.evidence import cross_validated
from groundstation.discrepancy.findings import BaseChange
from groundstation.discrepancy.screening import removal_cost
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
from groundstation.identification.likelihood.motion import BODY_KEYS, MOTOR_KEYS, Point, absent
from groundstation.identification.likelihood.problem import Fit, Problem, bounded
from groundstation.identification.likelihood.spectra import linearise, unfitted
from groundstation.telemetry.packet import STANDARD_GRAVITY

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
