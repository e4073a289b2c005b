"""Gains by optimisation: the search, what is uncertain, the linear loops and the firmware's."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.control.firmware_loop import (
    GAIN_MOST,
    SUPPLY_MV,
    UNUSABLE,
    YIELDING,
    CascadeJudge,
    Plant,
    cascade_margins,
    plant_of_model,
)
from groundstation.control.firmwares import PidGains, Release, firmware_of_vehicle
from groundstation.control.linear_loop import DirectJudge, direct_margins
from groundstation.control.metrics import Margins
from groundstation.dynamics.meanings import DEAD_TIME, MOST_DELAY_S, MOST_STDERR, WORDS, suitability
from groundstation.dynamics.model import (
    ArxAxis,
    BodyConstants,
    Estimate,
    Model,
    model_vehicle,
    with_motor,
)
from groundstation.dynamics.registry import DELAY
from groundstation.dynamics.vehicle import MotorConstants
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array

# Global search over gains: scipy's differential evolution on whole populations.
#
# The judges are compiled and take a population at once. All that was ever judged is kept: the
# fronts are drawn from it.


MUTATION, CROSSOVER = 0.6, 0.9
STALL, STALLED = 25, 1e-4
"""Generations after which a search ends that has gained less than this share."""


@dataclass(frozen=True, slots=True)
class Budget:
    """first: random candidates, of which the first generation is the best. population:
    individuals. generations: at most."""

    first: int = 1500
    population: int = 48
    generations: int = 70


@dataclass
class Archive:
    """Everything judged so far: candidates (n, d) and judgements (n, c)."""

    candidates: list[Array] = field(default_factory=list)
    judgements: list[Array] = field(default_factory=list)

    def add(self, candidates: Array, judgements: Array) -> None:
        good = np.isfinite(judgements).all(axis=1)
        self.candidates.append(candidates[good])
        self.judgements.append(judgements[good])

    def table(self) -> tuple[Array, Array]:
        """All of them as two arrays, row by row."""
        return np.vstack(self.candidates), np.vstack(self.judgements)


def search(
    judge: Callable[[Array], Array],
    score: Callable[[Array], Array],
    low: Array,
    high: Array,
    archive: Archive,
    seed: int,
    budget: Budget,
    start: Array | None = None,
) -> tuple[Array, Array]:
    """The candidate with the lowest score, and its judgement.

    Candidates are searched on a logarithmic scale between low and high (d,), all positive.
    score: judgements (m, c) to (m,), infinite only where nothing can be compared.
    start: (s, d) candidates to begin with beside random ones.
    """
    from scipy.optimize import differential_evolution

    generator = np.random.default_rng(seed)
    bottom, span = np.log(low), np.log(high) - np.log(low)
    least: list[float] = []

    def candidates_of(points: Array) -> Array:
        return np.exp(bottom + span * points)

    def scores(points: Array) -> Array:
        """Of points (d, m) in the unit cube."""
        candidates = candidates_of(points.T)
        judgements = judge(candidates)
        archive.add(candidates, judgements)
        return score(judgements)

    def stalled(intermediate_result: Any) -> bool:
        least.append(float(intermediate_result.fun))
        return len(least) > STALL and least[-1] > least[-1 - STALL] * (1 - STALLED)

    points = generator.random((budget.first, len(low)))
    if start is not None and len(start):
        points = np.vstack([np.clip((np.log(start) - bottom) / span, 0, 1), points])
    first = points[np.argsort(scores(points.T), kind="stable")[: budget.population]]
    found = differential_evolution(
        scores,
        [(0.0, 1.0)] * len(low),
        strategy="randtobest1bin",
        init=first,
        mutation=MUTATION,
        recombination=CROSSOVER,
        maxiter=budget.generations,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=generator,
        callback=stalled,
    )
    winner = candidates_of(found.x)
    return winner, judge(winner[None])[0]


def pareto_front(costs: Array) -> NDArray[np.intp]:
    """Rows of costs (n, c) that no other row equals or beats in every column, sorted by the
    first column."""
    left = np.lexsort(costs.T[::-1])
    # In the first column none is better than one before it.
    others, front = np.ascontiguousarray(costs.T[1:]).take(left, axis=1), []
    while len(left):
        front.append(left[0])
        better = np.flatnonzero((others < others[:, :1]).any(axis=0))
        left, others = left[better], others.take(better, axis=1)
    return np.array(front, np.intp)


# What the fit is unsure of, as other models that could be the true one.


BODY = ("c0", "c1", "c2", "thrust_per_mass")
MOTOR = ("a0", "a1", "a2")
CORNER = 2.0
"""Standard errors to either side that a design must bear."""
LEAST_CORNER = 0.05
RECORD = {
    "c0": "roll doublets of +-8 deg or more, 30 s of them",
    "c1": "pitch doublets of +-8 deg or more, 30 s of them",
    "c2": "yaw rate doublets of +-90 deg/s or more, 60 s of them, fitted with"
    " the effects that 'fit body' says the data show",
    DELAY: f"fast roll and pitch doublets, 30 s of them, fitted with --with {DEAD_TIME}",
}


def estimates_of(model: Model) -> list[tuple[tuple[str, ...], Array, Array]]:
    """What the model's fits estimated: (names, values (p,), covariance (p, p)) of each fit.

    Names are those of ``BODY``, ``MOTOR`` and ``effect.parameter``.
    """
    found = []
    for stage in ("motor", "body"):
        account: dict[str, Any] = model.fit.get(stage, {}).get("estimates", {})
        names = tuple(account.get("names", ()))
        covariance = np.array(account.get("covariance", ()), np.float64)
        if names and covariance.shape == (len(names), len(names)):
            found.append((names, np.array(account["values"], np.float64), covariance))
    return found


def standard_errors(model: Model) -> dict[str, tuple[float, float]]:
    """Parameter -> (value, standard error), of everything that the model's fits estimated."""
    return {
        name: (float(value), float(math.sqrt(max(variance, 0.0))))
        for names, values, covariance in estimates_of(model)
        for name, value, variance in zip(names, values, np.diag(covariance), strict=True)
    }


def require_certain(model: Model, axes: Sequence[str]) -> None:
    """Raises BadInputError for axes of a model that no gains are designed on
    (``dynamics.suitability``): why, and what to record."""
    found = suitability(model)
    refused = [axis for axis in axes if axis in found and not found[axis].designs]
    if not refused:
        return
    told = model.fit["body"].get("record", {})
    why, record = [], []
    for axis in refused:
        one = found[axis]
        why.append(f"{axis}: the model is {WORDS[one.use]} ({one.key}: {one.reasons[0]})")
        record.append(told.get(one.key, RECORD[one.key]))
    others = [f"--axis {axis}" for axis in axes if axis not in refused]
    raise BadInputError(
        f"{'; '.join(why)}; a standard error of {100 * MOST_STDERR:.0f} %, of a delay"
        f" {1e3 * MOST_DELAY_S:g} ms, is the most for a design; record"
        f" {', and '.join(dict.fromkeys(record))}, and fit again"
        + (f"; the rest can be designed: {' '.join(others)}" if others else "")
    )


def draws(model: Model, count: int, seed: int = 0) -> list[Model]:
    """Models drawn from the fits' covariances, each of which could be the true one.

    Raises BadInputError where the model carries no covariance.
    """
    parts = estimates_of(model)
    if not parts:
        raise BadInputError(
            f"model for {model.vehicle}: it carries no covariance, so nothing can be said about"
            " its uncertainty; fit it from a recording ('groundstation fit body')"
        )
    generator = np.random.default_rng(seed)
    moves = []
    for names, _, covariance in parts:
        roots, vectors = np.linalg.eigh(covariance)
        scale = vectors * np.sqrt(np.maximum(roots, 0.0))
        moves.append((names, generator.standard_normal((count, len(names))) @ scale.T))
    return [
        moved(
            model,
            {
                name: float(difference)
                for names, table in moves
                for name, difference in zip(names, table[index], strict=True)
            },
        )
        for index in range(count)
    ]


def corners(model: Model, axis: str) -> list[Model]:
    """The model itself and two others, two standard errors away for the worse: a loop gain that
    is higher with a longer delay, and one that is lower with a longer delay.

    A loop gain is taken for uncertain by 5 % at least: a battery moves it by more in a flight.
    """
    known = standard_errors(model)
    name = BODY[AXES.index(axis)]
    nominal = getattr(model.body, name)
    _, gain = known.get(name, (0.0, 0.0))
    _, late = known.get(DELAY, (0.0, 0.0))
    gain = max(CORNER * gain, LEAST_CORNER * nominal)
    return [
        model,
        *(moved(model, {name: sign * gain, DELAY: CORNER * late}) for sign in (1.0, -1.0)),
    ]


def moved(model: Model, differences: dict[str, float]) -> Model:
    """The model with parameters changed by differences; what must be positive stays so."""
    motor = {n: getattr(model.motor, n) + differences.get(n, 0.0) for n in MOTOR}
    motor["a0"], motor["a1"] = _positive(motor["a0"]), _positive(motor["a1"])
    body = model.body
    if body is not None:
        constants = {n: _positive(getattr(body, n) + differences.get(n, 0.0)) for n in BODY}
        body = BodyConstants(**constants)
    effects = []
    for term in model.effects:
        parameters = {}
        for name, estimate in term.parameters.items():
            value = estimate.value + differences.get(f"{term.name}.{name}", 0.0)
            if term.name == DEAD_TIME:
                value = max(value, 0.0)
            parameters[name] = Estimate(value, estimate.stderr, estimate.unit)
        effects.append(msgspec.structs.replace(term, parameters=parameters))
    return msgspec.structs.replace(
        with_motor(model, MotorConstants(**motor)), body=body, effects=tuple(effects)
    )


def _positive(value: float) -> float:
    return max(value, 1e-12)


# Gains by optimisation: the best tracking that a stated robustness allows.
#
# Among all gains that keep the limits (``Limits``) the design has the smallest sum of two ratios:
# its settling time over the shortest that any such gains reach, and its overshoot over the
# smallest (each plus 5 points, so that overshoots near zero do not decide alone). That is a point
# of the Pareto front of overshoot and settling at the limit of maximum sensitivity.


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


# Gains for the firmware's loops: designed axis by axis, tried on what the fit is unsure of.


WINDOW_S = 1.5
LOW: dict[Release, dict[str, tuple[float, ...]]] = {
    "2014": {"roll": (0.5, 0.2, 0.05, 0.002), "yaw": (1.0, 1.0)},
    "2.x": {"roll": (10.0, 1.0, 0.02, 0.5, 0.05), "yaw": (10.0, 0.5, 0.5, 0.05)},
}
HIGH: dict[Release, dict[str, tuple[float, ...]]] = {
    "2014": {"roll": (300.0, 60.0, 100.0, 10.0), "yaw": (GAIN_MOST, GAIN_MOST)},
    "2.x": {
        "roll": (GAIN_MOST, GAIN_MOST, 20.0, 60.0, 60.0),
        "yaw": (GAIN_MOST, 300.0, 40.0, 40.0),
    },
}
"""Where gains are searched, in the order of ``Firmware.gain_names``; pitch as roll."""
MOST_EFFORT = 0.15
"""Largest step of a motor, as a share of full PWM: what hover leaves to either side, less a
reserve for the height."""
AS_STIFF = 1.0 + 1e-6
"""As the stock gains, but for rounding."""
OVERSHOOT_MORE = 2.5
"""Points that gains may overshoot more than the stock ones by the model: half of what is written
(``learn``), for a flight is off by as much again."""
DESIGN_BAND = 0.035
"""Responses that settle only just within the 5 % are not looked for: noise would unsettle them."""
BUDGET = Budget(first=250, population=24, generations=36)
DRAWS = 1000


@dataclass(frozen=True, slots=True)
class AxisDesign:
    """Gains of one axis by the firmware's names, with what they do on the nominal model.

    before: the judgement of the stock gains by what judged the design (inf where they are
    unstable), stock_margins theirs in any case. reasons: one line for each gain.
    """

    axis: str
    gains: dict[str, float]
    design: Design
    before: Array
    nominal: Array
    margins: Margins
    stock_margins: Margins
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Robustness:
    """Judgements (n, 7) of a design on n drawn models, per axis; stable: how many stayed so."""

    drawn: int
    stable: dict[str, int]
    judgements: dict[str, Array]


def cascade_limits(sensitivity: float = 2.0, delay_s: float = 0.002) -> Limits:
    """The limits of a design for the firmware."""
    return Limits(sensitivity=sensitivity, delay_s=delay_s, effort=MOST_EFFORT, yielding=YIELDING)


def design_cascade(
    model: Model,
    axes: Sequence[str],
    limits: Limits,
    seed: int = 0,
    supply_mv: float = SUPPLY_MV,
    budget: Budget = BUDGET,
    progress: Callable[[str, float], None] = lambda axis, share: None,
    release: str | None = None,
) -> list[AxisDesign]:
    """Gains for each axis of a fitted model, on every core.

    A design must keep its limits on the model and two standard errors away from it
    (``uncertainty.corners``). release: of the firmware, None: the vehicle's.

    Raises BadInputError where the model is too uncertain, or no gains keep the limits.
    """
    require_certain(model, axes)

    def one(axis: str) -> AxisDesign:
        plants, judge, low, high, stock = _searched(model, axis, limits, supply_mv, release)
        design = optimise(
            judge, low, high, limits, seed, budget, progress=lambda s: progress(axis, s)
        )
        gains = {n: _rounded(v) for n, v in zip(stock, design.gains, strict=True)}
        alone = CascadeJudge(plants[:1], axis, WINDOW_S, 0.0, supply_mv)
        nominal = alone(np.array([list(gains.values())]))[0]
        return AxisDesign(
            axis,
            gains,
            design,
            judge(np.array([list(stock.values())]))[0],
            nominal,
            cascade_margins(plants[0], gains, axis, supply_mv),
            cascade_margins(plants[0], stock, axis, supply_mv),
            reasons(alone, gains, {name: gain_meaning(name)[1] for name in gains}, limits),
        )

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(one, axes))


def closest_cascade(
    model: Model,
    axis: str,
    limits: Limits,
    seed: int = 0,
    supply_mv: float = SUPPLY_MV,
    budget: Budget = BUDGET,
    release: str | None = None,
) -> tuple[dict[str, float], Array, Array]:
    """Gains of an axis that follow a step the closest within the limits; their judgement, and that
    of the stock gains that it begins with.

    They keep the limits as ``design_cascade``'s do, with those that the stock gains set: where
    these are more sensitive than the limit, or ask more of the motors, so may the gains be; a push
    that lasts moves the craft no further than with them, a fast one twice as far (``CascadeJudge``,
    beside); they overshoot ``OVERSHOOT_MORE`` points more at most.

    Raises BadInputError where the model is too uncertain, or no gains keep the limits.
    """
    _, judge, low, high, names = _searched(
        model, axis, limits, supply_mv, release, unusable=math.inf, beside_stock=True
    )
    stock = np.array([list(names.values())])
    before = judge(stock)[0]
    if np.isfinite(before[SENSITIVITY]):
        limits = msgspec.structs.replace(
            limits,
            sensitivity=max(limits.sensitivity, float(before[SENSITIVITY])),
            effort=max(limits.effort, float(before[EFFORT])),
            offset=max(limits.offset, float(before[OFFSET])),
            compliance=AS_STIFF,
            overshoot=float(before[OVERSHOOT]) + OVERSHOOT_MORE,
        )
    start = np.clip(stock, low, high)
    gains, judged = closest(judge, low, high, limits, start, seed, budget)
    return {n: _rounded(v) for n, v in zip(names, gains, strict=True)}, judged, before


def _searched(
    model: Model,
    axis: str,
    limits: Limits,
    supply_mv: float,
    release: str | None,
    unusable: float = UNUSABLE,
    beside_stock: bool = False,
) -> tuple[list[Plant], CascadeJudge, Array, Array, dict[str, float]]:
    """Plants of a model (the nominal one first), their judge, where gains are searched, (d,) each,
    and the stock gains. Raises BadInputError where the model is too uncertain."""
    require_certain(model, (axis,))
    firmware = firmware_of_vehicle(model_vehicle(model), release)
    plants = [plant_of_model(other, release=release) for other in corners(model, axis)]
    stock = {name: firmware.stock[name] for name in firmware.gain_names(axis)}
    beside = stock if beside_stock else None
    judge = CascadeJudge(
        plants, axis, WINDOW_S, limits.delay_s, supply_mv, DESIGN_BAND, unusable, beside
    )
    kind = "yaw" if axis == "yaw" else "roll"
    low, high = np.array(LOW[firmware.name][kind]), np.array(HIGH[firmware.name][kind])
    return plants, judge, low, high, stock


def robustness(
    model: Model,
    gains: Mapping[str, float],
    axes: Sequence[str],
    count: int = DRAWS,
    seed: int = 0,
    supply_mv: float = SUPPLY_MV,
    release: str | None = None,
) -> Robustness | None:
    """How gains do on models drawn from the fit's covariance; None where it carries none."""
    if not estimates_of(model):
        return None
    plants = [plant_of_model(other, release=release) for other in draws(model, count, seed)]
    names = firmware_of_vehicle(model_vehicle(model), release).gain_names
    cores = os.cpu_count() or 1
    judgements = {}
    with ThreadPoolExecutor(cores) as pool:
        for axis in axes:
            values = np.array([[gains[name] for name in names(axis)]])
            slices = [plants[i::cores] for i in range(cores)]

            def judged(part: Sequence[Plant], axis: str = axis, values: Array = values) -> Array:
                return np.vstack(
                    [CascadeJudge([p], axis, WINDOW_S, 0.0, supply_mv)(values) for p in part]
                )

            judgements[axis] = np.vstack(list(pool.map(judged, slices)))
    stable = {axis: int(np.isfinite(table[:, 0]).sum()) for axis, table in judgements.items()}
    return Robustness(count, stable, judgements)


def _rounded(value: float) -> float:
    """To four significant digits, which is more than a gain means."""
    return float(f"{value:.4g}")


PURPOSE = {
    ("pid_rate", "kp"): "damps the rate against the motors' lag",
    ("pid_rate", "kd"): "turns the loop forward against the motors' lag and the filters'",
    ("pid_rate", "ki"): "removes lasting rate errors, such as trim",
    ("pid_attitude", "kp"): "sets how fast the angle follows",
    ("pid_attitude", "ki"): "removes the lean of the attitude filter and trim",
    ("pid_attitude", "kd"): "pushes at once when the setpoint moves, ahead of the motors' lag",
}


_UNITS = {
    ("pid_rate", "kp"): "PWM counts per deg/s",
    ("pid_rate", "ki"): "PWM counts per deg",
    ("pid_rate", "kd"): "PWM counts per deg/s²",
    ("pid_attitude", "kp"): "deg/s per deg",
    ("pid_attitude", "ki"): "deg/s per deg s",
    ("pid_attitude", "kd"): "deg/s per deg/s",
}


def gain_meaning(name: str) -> tuple[str, str]:
    """(unit, meaning) of one of the firmware's gains."""
    which = name.split(".")[0], name.split("_")[-1]
    return _UNITS[which], PURPOSE[which]
