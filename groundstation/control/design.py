"""Gains by optimisation: the best tracking that a stated robustness allows.

Among all gains that keep the limits (``Limits``) the design has the smallest sum of two ratios:
its settling time over the shortest that any such gains reach, and its overshoot over the
smallest (each plus 5 points, so that overshoots near zero do not decide alone). That is a point
of the Pareto front of overshoot and settling at the limit of maximum sensitivity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.control.linear_loop import DirectJudge, direct_margins
from groundstation.control.margins import Margins
from groundstation.control.pid import PidGains
from groundstation.control.search import Archive, Budget, pareto_front, search
from groundstation.dynamics.model import ArxAxis
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import Array

RMS, OVERSHOOT, SETTLING, OFFSET, SENSITIVITY, EFFORT, COMPLIANCE = range(7)
"""Columns of a judgement."""
POINTS = 5.0
"""Overshoot in percent points that weighs as much as the smallest one possible."""
OTHER_LIMITS = (1.4, 1.7, 2.5, 3.0)
"""Maximum sensitivities at which the front is drawn beside the chosen one."""
ALONG = (0.1, 0.25, 0.5)
"""Where the front is traced between its two ends, as shares of the overshoot."""


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """What a design must keep.

    sensitivity: largest max |1/(1+L)|; 2 leaves a gain margin of 2 and a phase margin of 29 deg.
    delay_s: more delay that the loop must bear.
    offset: largest steady-state error, as a share of the step.
    effort: largest controller output for a unit step, inf for any.
    yielding: how far a push may move the craft, over the least that the other limits allow; inf
        for any. Without it a loop that follows the setpoint by pushing ahead may be soft.
    compliance: the same as a number. overshoot: in percent, inf for any.
    """

    sensitivity: float = 2.0
    delay_s: float = 0.002
    offset: float = 0.02
    effort: float = math.inf
    yielding: float = math.inf
    compliance: float = math.inf
    overshoot: float = math.inf


@dataclass(frozen=True, slots=True)
class Design:
    """Chosen gains and how they came about.

    gains: (d,). judgement: its seven columns. front: (n, 7) judgements of the Pareto front of
    overshoot, settling and maximum sensitivity, front_gains (n, d). fastest, calmest: the
    shortest settling (s) and smallest overshoot (%) that the limits allow.
    """

    gains: Array
    judgement: Array
    front: Array
    front_gains: Array
    fastest: float
    calmest: float


def optimise(
    judge: Callable[[Array], Array],
    low: Array,
    high: Array,
    limits: Limits,
    seed: int = 0,
    budget: Budget = Budget(),
    start: Array | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Design:
    """The design for any judge of gains (m, d) that answers with the seven columns.

    Raises BadInputError where no gains keep the limits: with the best sensitivity found.
    """
    archive = Archive()
    runs = 3 + len(ALONG) + 2 * len(OTHER_LIMITS) + math.isfinite(limits.yielding)
    done = 0

    def best(score: Callable[[Array], Array], start: Array | None) -> tuple[Array, Array]:
        nonlocal done
        found = search(judge, score, low, high, archive, seed + done, budget, start)
        done += 1
        progress(done / runs)
        return found

    def within(values: Callable[[Array], Array], peak: float, most: float = math.inf) -> Scorer:
        return Scorer(values, msgspec.structs.replace(limits, sensitivity=peak), most)

    peak = limits.sensitivity
    if math.isfinite(limits.yielding):
        stiff_gains, stiff = best(within(lambda j: j[:, COMPLIANCE], peak), start)
        limits = msgspec.structs.replace(limits, compliance=limits.yielding * stiff[COMPLIANCE])
        start = stiff_gains[None]
    fast_gains, fast = best(within(lambda j: j[:, SETTLING], peak), start)
    if not _kept(fast[None], limits)[0]:
        raise BadInputError(_impossible(archive, limits))
    calm_gains, calm = best(within(lambda j: j[:, OVERSHOOT], peak), fast_gains[None])
    known = np.vstack([fast_gains, calm_gains])
    knee = _knee(fast[SETTLING], calm[OVERSHOOT])
    chosen, _ = best(within(knee, peak), known)
    known = np.vstack([known, chosen])
    for share in ALONG:
        most = calm[OVERSHOOT] + share * (fast[OVERSHOOT] - calm[OVERSHOOT])
        best(within(lambda j: j[:, SETTLING], peak, most), known)
    for other in OTHER_LIMITS:
        gains, _ = best(within(lambda j: j[:, SETTLING], other), known)
        best(within(lambda j: j[:, OVERSHOOT], other), np.vstack([known, gains]))
    return _of_all(*archive.table(), limits)


def _of_all(candidates: Array, judgements: Array, limits: Limits) -> Design:
    """The best of all gains (n, d) that were judged (n, 7), and their front: what the later
    searches found on the way may be better than what they were made for."""
    kept = _kept(judgements, limits)
    fastest, calmest = judgements[kept, SETTLING].min(), judgements[kept, OVERSHOOT].min()
    values = np.where(kept, _knee(fastest, calmest)(judgements), np.inf)
    winner = int(np.argmin(values))
    loose = (judgements[:, OFFSET] <= limits.offset) & (judgements[:, EFFORT] <= limits.effort)
    loose &= judgements[:, COMPLIANCE] <= limits.compliance
    loose &= judgements[:, SENSITIVITY] <= max(OTHER_LIMITS)
    front = np.flatnonzero(loose)
    front = front[pareto_front(judgements[front][:, [OVERSHOOT, SETTLING, SENSITIVITY]])]
    return Design(
        candidates[winner],
        judgements[winner],
        judgements[front],
        candidates[front],
        float(fastest),
        float(calmest),
    )


def closest(
    judge: Callable[[Array], Array],
    low: Array,
    high: Array,
    limits: Limits,
    start: Array,
    seed: int = 0,
    budget: Budget = Budget(),
) -> tuple[Array, Array]:
    """Of the gains that keep the limits those that follow a step the closest (RMS), and their
    judgement: one search, where ``optimise`` draws whole fronts. start: (s, d) to begin with.

    Raises BadInputError where no gains keep the limits.
    """
    archive = Archive()
    score = Scorer(lambda j: j[:, RMS], limits, limits.overshoot)
    gains, judged = search(judge, score, low, high, archive, seed, budget, start)
    if not _kept(judged[None], limits)[0]:
        raise BadInputError(_impossible(archive, limits))
    return gains, judged


class Scorer:
    """A value to be small, where the limits are kept; elsewhere by how much they are not."""

    def __init__(self, value: Callable[[Array], Array], limits: Limits, overshoot: float) -> None:
        self._value, self._limits, self._overshoot = value, limits, overshoot

    def __call__(self, judgements: Array) -> Array:
        limits = self._limits
        with np.errstate(invalid="ignore"):
            missed = (
                np.maximum(judgements[:, SENSITIVITY] / limits.sensitivity - 1, 0)
                + np.maximum(judgements[:, OFFSET] / limits.offset - 1, 0)
                + np.maximum(judgements[:, EFFORT] / limits.effort - 1, 0)
                + np.maximum(judgements[:, COMPLIANCE] / limits.compliance - 1, 0)
                + np.maximum(judgements[:, OVERSHOOT] / max(self._overshoot, 1e-9) - 1, 0)
            )
            missed = np.where(np.isfinite(judgements[:, SETTLING]), missed, missed + 100.0)
            score = np.where(missed > 0, 1e3 * (1 + missed), self._value(judgements))
        return np.where(np.isfinite(score), score, 1e12)


def design_direct(
    plant: ArxAxis,
    limits: Limits,
    seconds: float = 2.0,
    seed: int = 0,
    budget: Budget = Budget(),
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[PidGains, Design, Margins]:
    """A PID in the thesis's form for an axis, and its margins.

    Raises BadInputError where no gains keep the limits.
    """
    low, high = direct_bounds(plant)
    judge = DirectJudge(plant, seconds, limits.delay_s)
    design = optimise(judge, low, high, limits, seed, budget, progress=progress)
    gains = PidGains(*(float(g) for g in design.gains))
    return gains, design, direct_margins(plant, gains)


def reasons(
    judge: Callable[[Array], Array],
    gains: Mapping[str, float],
    purposes: Mapping[str, str],
    limits: Limits,
) -> tuple[str, ...]:
    """One line a gain: what it is for, and what a quarter more or a fifth less would do."""
    values = np.array(list(gains.values()))
    lines = []
    for index, (name, value) in enumerate(gains.items()):
        rows = np.array([values] * 3)
        rows[:, index] *= (1.0, 1.25, 0.8)
        now, more, less = judge(rows)
        lines.append(
            f"{name} = {value:.4g}: {purposes[name]}; 25 % more: {_change(now, more, limits)};"
            f" 20 % less: {_change(now, less, limits)}"
        )
    return tuple(lines)


def _change(now: Array, then: Array, limits: Limits) -> str:
    if not np.isfinite(then).all():
        return "does not settle or is near instability"
    words = []
    if abs(then[SETTLING] - now[SETTLING]) > 0.004:
        words.append(
            f"settles in {1e3 * then[SETTLING]:.0f} ms instead of {1e3 * now[SETTLING]:.0f}"
        )
    if abs(then[OVERSHOOT] - now[OVERSHOOT]) > 0.5:
        words.append(f"overshoot {then[OVERSHOOT]:.0f} % instead of {now[OVERSHOOT]:.0f}")
    if abs(then[SENSITIVITY] - now[SENSITIVITY]) > 0.03:
        beyond = " (beyond the limit)" if then[SENSITIVITY] > limits.sensitivity else ""
        words.append(f"maximum sensitivity {then[SENSITIVITY]:.2f}{beyond}")
    return ", ".join(words) or "little changes"


def direct_bounds(plant: ArxAxis) -> tuple[Array, Array]:
    """Where kp, ki, kd are searched: bandwidths of 0.3 to 300 rad/s of a double integrator with
    the plant's acceleration per unit of input."""
    acceleration = sum(plant.b) / plant.ts**2
    return (
        np.array([0.1, 0.01, 0.1]) / acceleration,
        np.array([1e5, 1e6, 300.0]) / acceleration,
    )


def _knee(fastest: float, calmest: float) -> Callable[[Array], Array]:
    def value(judgements: Array) -> Array:
        fast = judgements[:, SETTLING] / fastest
        calm = (judgements[:, OVERSHOOT] + POINTS) / (calmest + POINTS)
        return fast + calm

    return value


def _kept(judgements: Array, limits: Limits) -> NDArray[np.bool_]:
    return (
        (judgements[:, SENSITIVITY] <= limits.sensitivity)
        & (judgements[:, OFFSET] <= limits.offset)
        & (judgements[:, EFFORT] <= limits.effort)
        & (judgements[:, COMPLIANCE] <= limits.compliance)
        & (judgements[:, OVERSHOOT] <= limits.overshoot)
        & np.isfinite(judgements[:, SETTLING])
    )


def _impossible(archive: Archive, limits: Limits) -> str:
    _, judgements = archive.table()
    wanted = f"maximum sensitivity {limits.sensitivity:g}, {limits.delay_s * 1e3:g} ms of spare"
    wanted += f" delay, steady-state error {100 * limits.offset:g} %"
    if len(judgements) == 0:
        return f"no gains make this model stable ({wanted}): the delay is too long for it"
    best = float(judgements[:, SENSITIVITY].min())
    if best <= limits.sensitivity:
        robust = judgements[judgements[:, SENSITIVITY] <= limits.sensitivity]
        least = robust.min(axis=0)
        return (
            f"no gains keep the limits ({wanted}) on this model: those robust enough leave"
            f" {100 * least[OFFSET]:.1f} % of the step at least, or ask {least[EFFORT]:.3g} of the"
            f" motors where {limits.effort:.3g} is the most"
        )
    return (
        f"no gains keep the limits ({wanted}) on this model: the smallest maximum sensitivity"
        f" found is {best:.2f}; allow more (--sensitivity), or know the model better"
    )
