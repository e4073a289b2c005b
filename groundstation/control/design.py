"""Gains by optimisation: the search, what is uncertain, the linear loops and the firmware's."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Protocol

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
    Worth,
    cascade_loop,
    plant_of_model,
)
from groundstation.control.firmwares import PidGains, Release, firmware_of_vehicle
from groundstation.control.linear_loop import DirectJudge, direct_loop
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
"""Generations after which a search ends whose score, a logarithm, has fallen by less than this."""


@dataclass(frozen=True, slots=True)
class Budget:
    """first: random candidates, of which the first generation is the best. population:
    individuals. generations: at most."""

    first: int = 1500
    population: int = 48
    generations: int = 70


Judged = list[tuple[Array, Array]]
"""What was judged so far: candidates (n, d) with finite judgements (n, c)."""


class Judge(Protocol):
    """Gains (m, d) to judgements (m, c), infinite where they are no good."""

    def __call__(self, candidates: Array, worth: Worth = ...) -> Array: ...


def search(
    judge: Judge,
    score: Callable[[Array], Array],
    low: Array,
    high: Array,
    archive: Judged,
    seed: int,
    budget: Budget,
    start: Array | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[Array, Array]:
    """The candidate with the lowest score, and its judgement.

    Candidates are searched on a logarithmic scale between low and high (d,), all positive.
    score: judgements (m, c) to (m,), no smaller for a judgement that is larger.
    start: (s, d) candidates to begin with beside random ones.
    """
    from scipy.optimize import differential_evolution

    generator = np.random.default_rng(seed)
    bottom, span = np.log(low), np.log(high) - np.log(low)
    least: list[float] = []
    held = np.full(budget.first + (0 if start is None else len(start)), np.inf)

    def candidates_of(points: Array) -> Array:
        return np.exp(bottom + span * points)

    def worth(rows: NDArray[np.intp], judgements: Array) -> NDArray[np.bool_]:
        """Whether candidates may still replace those of the generation before."""
        return np.asarray(score(judgements) <= held[rows], np.bool_)

    def scores(points: Array) -> Array:
        """Of points (d, m) in the unit cube."""
        candidates = candidates_of(points.T)
        judgements = judge(candidates, worth)
        good = np.isfinite(judgements).all(axis=1)
        archive.append((candidates[good], judgements[good]))
        return score(judgements)

    def stalled(intermediate_result: Any) -> bool:
        held[: budget.population] = intermediate_result.population_energies
        least.append(float(intermediate_result.fun))
        progress(len(least) / budget.generations)
        return len(least) > STALL and least[-1 - STALL] - least[-1] < STALLED

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

    Names are those of ``BODY``, a0, a1, a2 of the motor, and ``effect.parameter``.
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
    (``meanings.suitability``): why, and what to record."""
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
    moves: dict[str, list[float]] = {}
    for names, _, covariance in parts:
        roots, vectors = np.linalg.eigh(covariance)
        scale = vectors * np.sqrt(np.maximum(roots, 0.0))
        table = generator.standard_normal((count, len(names))) @ scale.T
        moves |= dict(zip(names, table.T.tolist(), strict=True))
    return [moved(model, {name: by[index] for name, by in moves.items()}) for index in range(count)]


def corners(model: Model, axis: str) -> list[Model]:
    """The model itself and two others, two standard errors away for the worse: a loop gain that
    is higher with a longer delay, and one that is lower with a longer delay.

    A loop gain is taken for uncertain by 5 % at least: a battery moves it by more in a flight.
    """
    known = standard_errors(model)
    name = BODY[AXES.index(axis)]
    gain, late = (CORNER * known.get(each, (0.0, 0.0))[1] for each in (name, DELAY))
    gain = max(gain, LEAST_CORNER * getattr(model.body, name))
    return [model, *(moved(model, {name: sign * gain, DELAY: late}) for sign in (1.0, -1.0))]


def moved(model: Model, differences: dict[str, float]) -> Model:
    """The model with parameters changed by differences; what must be positive stays so."""

    def at(name: str, value: float, least: float = 1e-12) -> float:
        return max(value + differences.get(name, 0.0), least)

    motor, body = model.motor, model.body
    if body is not None:
        body = BodyConstants(**{name: at(name, getattr(body, name)) for name in BODY})
    effects = []
    for term in model.effects:
        least = 0.0 if term.name == DEAD_TIME else -math.inf
        parameters = {
            name: Estimate(at(f"{term.name}.{name}", one.value, least), one.stderr, one.unit)
            for name, one in term.parameters.items()
        }
        effects.append(msgspec.structs.replace(term, parameters=parameters))
    motor = MotorConstants(at("a0", motor.a0), at("a1", motor.a1), at("a2", motor.a2, -math.inf))
    return msgspec.structs.replace(with_motor(model, motor), body=body, effects=tuple(effects))


# Gains by optimisation: one criterion in which a tenth of each of four figures weighs the same.
#
# The criterion is a product, so that no figure needs a scale and no gains beat the chosen ones in
# all four. Overshoot counts from -5 points on, so that overshoots near zero do not decide alone.


RMS, OVERSHOOT, SETTLING, OFFSET, SENSITIVITY, EFFORT, COMPLIANCE = range(7)
"""Columns of a judgement."""
POINTS = 5.0
"""Overshoot in percent points that doubles what an overshoot of zero counts."""
CRITERION = (
    "of all gains that keep the limits these have the smallest product of RMS error, settling time,"
    f" overshoot plus {POINTS:g} points, and maximum sensitivity"
)
"""What ``criterion`` is, in a sentence."""
SHORTEST_S = 1e-3
"""Settling times below it count as it: half a period of the loops."""
MISSED, BEYOND = 1e3, 100.0
"""Added to the score of gains that miss a limit, and of those more sensitive than the limit but no
more than the stock gains: far above any logarithm of the criterion, which is within 20."""
WIDER, SEARCHES = 2, 2
"""Times the candidates, and searches, where the stock gains set no limits: settling then has a step
(a response creeps into its band, or is there at once), and one search in six stays on its far side.
"""
FRONT_SENSITIVITY = 3.0
"""The front is drawn up to this maximum sensitivity, also beyond the limit."""


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """What a design must keep.

    sensitivity: largest max |1/(1+L)|; 2 leaves a gain margin of 2 and a phase margin of 29 deg.
    strict: whether somebody asked for that ``sensitivity``: stock gains that are more sensitive set
        no limits then.
    stock_sensitivity: that of the stock gains, borne where no gains within ``sensitivity`` keep the
        other limits.
    delay_s: more delay that the loop must bear.
    offset: largest steady-state error, as a share of the step.
    effort: largest controller output for a unit step, inf for any.
    yielding: how far a push may move the craft, over the least that the other limits allow; inf
        for any. Without it a loop that follows the setpoint by pushing ahead may be soft.
    compliance: the same as a number. rms: as a share of the step, settling_s, overshoot in percent:
        inf for any.
    """

    sensitivity: float = 2.0
    strict: bool = False
    stock_sensitivity: float = 0.0
    delay_s: float = 0.002
    offset: float = 0.02
    effort: float = math.inf
    yielding: float = math.inf
    compliance: float = math.inf
    rms: float = math.inf
    overshoot: float = math.inf
    settling_s: float = math.inf

    @property
    def most(self) -> Array:
        """Of each column of a judgement, (7,)."""
        peak = max(self.sensitivity, self.stock_sensitivity)
        first = self.rms, max(self.overshoot, 1e-9), self.settling_s
        return np.array([*first, self.offset, peak, self.effort, self.compliance])


@dataclass(frozen=True, slots=True)
class Design:
    """Chosen gains and how they came about.

    gains: (d,). judgement: its seven columns. front: (n, 7) judgements of the Pareto front of
    overshoot, settling and maximum sensitivity, front_gains (n, d). fastest, calmest: the
    shortest settling (s) and smallest overshoot (%) that were found within the limits.
    """

    gains: Array
    judgement: Array
    front: Array
    front_gains: Array
    fastest: float
    calmest: float


def criterion(judgements: Array) -> Array:
    """Of judgements (m, 7) the logarithm (m,) of what a design makes small (``CRITERION``)."""
    settling = np.maximum(judgements[:, SETTLING], SHORTEST_S)
    overshoot = judgements[:, OVERSHOOT] + POINTS
    product = judgements[:, RMS] * settling * overshoot * judgements[:, SENSITIVITY]
    return np.asarray(np.log(product), np.float64)


def optimise(
    judge: Judge,
    low: Array,
    high: Array,
    limits: Limits,
    seed: int = 0,
    budget: Budget = Budget(),
    start: Array | None = None,
    progress: Callable[[float], None] = lambda share: None,
    ends: bool = False,
) -> Design:
    """The design for any judge of gains (m, d) that answers with the seven columns.

    start: (s, d) to begin with. ends: search also for the shortest settling and the smallest
    overshoot that the limits allow, so that they are known to be the least.

    Raises BadInputError where no gains keep the limits: with the best sensitivity found.
    """
    archive: Judged = []
    yields = math.isfinite(limits.yielding) and not math.isfinite(limits.compliance)
    searches = SEARCHES if yields else 1
    runs, done = searches + yields + 2 * ends, 0

    def best(value: Callable[[Array], Array], start: Array | None) -> tuple[Array, Array]:
        nonlocal done
        score = _scorer(value, limits)
        found = search(
            judge, score, low, high, archive, seed + done, budget, start,
            lambda share: progress((done + share) / runs),
        )  # fmt: skip
        done += 1
        progress(done / runs)
        return found

    if yields:
        stiff_gains, stiff = best(lambda j: np.log(j[:, COMPLIANCE]), start)
        limits = msgspec.structs.replace(limits, compliance=limits.yielding * stiff[COMPLIANCE])
        start = stiff_gains[None]
        more = WIDER * budget.first, WIDER * budget.population
        budget = replace(budget, first=more[0], population=more[1])
    found = [best(criterion, start) for _ in range(searches)]
    gains, judged = min(found, key=lambda one: float(_scorer(criterion, limits)(one[1][None])[0]))
    if not _kept(judged[None], limits)[0]:
        raise BadInputError(_impossible(archive, limits))
    if ends:
        best(lambda j: j[:, SETTLING], gains[None])
        best(lambda j: j[:, OVERSHOOT], gains[None])
    candidates, judgements = (np.vstack(every) for every in zip(*archive, strict=True))
    return _of_all(candidates, judgements, limits)


def _of_all(candidates: Array, judgements: Array, limits: Limits) -> Design:
    """The best of all gains (n, d) that were judged (n, 7), and their front: what the later
    searches found on the way may be better than what they were made for."""
    kept = judgements[_kept(judgements, limits)]
    winner = int(np.argmin(_scorer(criterion, limits)(judgements)))
    peak = max(FRONT_SENSITIVITY, limits.stock_sensitivity)
    loose = msgspec.structs.replace(limits, stock_sensitivity=peak)
    front = np.flatnonzero(_kept(judgements, loose))
    front = front[pareto_front(judgements[front][:, [OVERSHOOT, SETTLING, SENSITIVITY]])]
    return Design(
        candidates[winner],
        judgements[winner],
        judgements[front],
        candidates[front],
        float(kept[:, SETTLING].min()),
        float(kept[:, OVERSHOOT].min()),
    )


def _scorer(value: Callable[[Array], Array], limits: Limits) -> Callable[[Array], Array]:
    """A value to be small, where the limits are kept; elsewhere by how much they are not."""
    most = limits.most

    def score(judgements: Array) -> Array:
        with np.errstate(invalid="ignore", divide="ignore"):
            missed = np.maximum(judgements / most - 1, 0).sum(axis=1)
            missed = np.where(np.isfinite(judgements[:, SETTLING]), missed, missed + 100.0)
            beyond = BEYOND * (judgements[:, SENSITIVITY] > limits.sensitivity)
            found = np.where(missed > 0, MISSED * (1 + missed), value(judgements) + beyond)
        return np.where(found < 1e12, found, 1e12)

    return score


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
    design = optimise(judge, low, high, limits, seed, budget, progress=progress, ends=True)
    gains = PidGains(*(float(g) for g in design.gains))
    return gains, design, direct_loop(plant, gains).margins


def reasons(
    judge: Judge,
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
    low, high = np.array([[0.1, 0.01, 0.1], [1e5, 1e6, 300.0]]) / (sum(plant.b) / plant.ts**2)
    return low, high


def _kept(judgements: Array, limits: Limits) -> NDArray[np.bool_]:
    kept = np.all(judgements <= limits.most, axis=1)
    return np.asarray(kept & np.isfinite(judgements[:, SETTLING]), np.bool_)


def _impossible(archive: Judged, limits: Limits) -> str:
    judgements = np.vstack([one for _, one in archive])
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
AS_GOOD = 1.0 + 1e-6
"""As the stock gains, but for rounding."""
MOST_OVERSHOOT = 25.0
"""Percent: a quarter, the most that classical tuning lets pass (Ziegler and Nichols, 1942)."""
OVERSHOOT_MORE = 2.5
"""Points that gains may overshoot more than the stock ones by the model: half of what is written
(``learn``), for a flight is off by as much again."""
DESIGN_BAND = 0.035
"""Responses that settle only just within the 5 % are not looked for: noise would unsettle them."""
BUDGET = Budget(first=250, population=24, generations=36)
DRAWS = 300
"""Where all of them are stable, so are 99 of 100 models (95 % confidence: the rule of three)."""


@dataclass(frozen=True, slots=True)
class AxisDesign:
    """Gains of one axis by the firmware's names, with what they do on the nominal model.

    before: the judgement of the stock gains by what judged the design (inf where they are
    unstable), stock_nominal that on the nominal model, stock_margins theirs in any case. The stock
    gains are the design where none is better on the nominal model. reasons: one line for each gain.
    """

    axis: str
    gains: dict[str, float]
    design: Design
    before: Array
    nominal: Array
    stock_nominal: Array
    margins: Margins
    stock_margins: Margins
    reasons: tuple[str, ...]

    @property
    def is_stock(self) -> bool:
        """Whether the stock gains stay."""
        return np.array_equal(self.nominal, self.stock_nominal)


@dataclass(frozen=True, slots=True)
class Robustness:
    """Judgements (n, 7) of a design on n drawn models, per axis; stable: how many stayed so."""

    drawn: int
    stable: dict[str, int]
    judgements: dict[str, Array]


def cascade_limits(sensitivity: float | None = None, delay_s: float = 0.002) -> Limits:
    """The limits of a design for the firmware. sensitivity: what somebody asks for; None: 2, or as
    much as the stock gains where none within that keep the other limits."""
    most = Limits().sensitivity if sensitivity is None else sensitivity
    strict = sensitivity is not None
    return Limits(
        sensitivity=most, strict=strict, delay_s=delay_s, effort=MOST_EFFORT, yielding=YIELDING
    )


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
    (``corners``). release: of the firmware, None: the vehicle's.

    Raises BadInputError where the model is too uncertain, or no gains keep the limits.
    """
    require_certain(model, axes)

    def one(axis: str) -> AxisDesign:
        plants, judge, low, high, stock, before = _searched(model, axis, limits, supply_mv, release)
        kept = limits_beside(before, limits)
        start = np.clip(np.array([list(stock.values())]), low, high)
        design = optimise(judge, low, high, kept, seed, budget, start, lambda s: progress(axis, s))
        gains = {n: _rounded(v) for n, v in zip(stock, design.gains, strict=True)}
        alone = CascadeJudge(plants[:1], axis, WINDOW_S, 0.0, supply_mv)
        nominal, untuned = alone(np.array([list(gains.values()), list(stock.values())]))
        no_better = criterion(untuned[None])[0] <= criterion(nominal[None])[0]
        most = limits.sensitivity if limits.strict else math.inf
        if no_better and np.isfinite(before).all() and before[SENSITIVITY] <= most:
            # better on the worst of the corners alone
            gains, nominal = stock, untuned
            design = replace(design, gains=np.array(list(stock.values())), judgement=before)
        return AxisDesign(
            axis,
            gains,
            design,
            before,
            nominal,
            untuned,
            cascade_loop(plants[0], gains, axis, supply_mv).margins,
            cascade_loop(plants[0], stock, axis, supply_mv).margins,
            reasons(alone, gains, {name: gain_meaning(name)[1] for name in gains}, limits),
        )

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(one, axes))


def comparable(stock: Array, limits: Limits) -> bool:
    """Whether gains are to be no worse than stock ones of which the judgement (7,) is given: not
    where these are stiff at the price of stability (``UNUSABLE``, or what somebody asked for) or of
    ``MOST_OVERSHOOT``."""
    most = limits.sensitivity if limits.strict else UNUSABLE
    return bool(stock[SENSITIVITY] <= most and stock[OVERSHOOT] <= MOST_OVERSHOOT)


def limits_beside(stock: Array, limits: Limits) -> Limits:
    """Limits of gains that are to be no worse than the stock ones, of which the judgement (7,) is
    given. Where these ask more of the motors, or leave more of the step, so may the gains; a push
    that lasts moves the craft no further than with them, a fast one twice as far (``CascadeJudge``,
    beside); RMS and settling are no larger, overshoot by ``OVERSHOOT_MORE`` points at most.

    Stock gains that are unstable, or nearly, set no limits (``comparable``).
    """
    if not comparable(stock, limits):
        return limits
    most = AS_GOOD * stock
    return msgspec.structs.replace(
        limits,
        stock_sensitivity=float(most[SENSITIVITY]),
        effort=max(limits.effort, float(most[EFFORT])),
        offset=max(limits.offset, float(most[OFFSET])),
        compliance=float(most[COMPLIANCE]),
        rms=float(most[RMS]),
        overshoot=float(stock[OVERSHOOT]) + OVERSHOOT_MORE,
        settling_s=float(most[SETTLING]),
    )


def _searched(
    model: Model, axis: str, limits: Limits, supply_mv: float, release: str | None
) -> tuple[list[Plant], CascadeJudge, Array, Array, dict[str, float], Array]:
    """Plants of a model (the nominal one first), their judge, where gains are searched, (d,) each,
    the stock gains and their judgement (7,).

    The judge's compliance is over that of the stock gains, where these are usable.
    """
    firmware = firmware_of_vehicle(model_vehicle(model), release)
    plants = [plant_of_model(other, release=release) for other in corners(model, axis)]
    stock = {name: firmware.stock[name] for name in firmware.gain_names(axis)}

    def judge(unusable: float, beside: Mapping[str, float] | None) -> CascadeJudge:
        return CascadeJudge(
            plants, axis, WINDOW_S, limits.delay_s, supply_mv, DESIGN_BAND, unusable, beside
        )

    before = judge(math.inf, stock)(np.array([list(stock.values())]))[0]
    beside = stock if comparable(before, limits) else None
    kind = "yaw" if axis == "yaw" else "roll"
    low, high = np.array(LOW[firmware.name][kind]), np.array(HIGH[firmware.name][kind])
    return plants, judge(UNUSABLE, beside), low, high, stock, before


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


_MEANINGS = {
    ("pid_rate", "kp"): ("PWM counts per deg/s", "damps the rate against the motors' lag"),
    ("pid_rate", "ki"): ("PWM counts per deg", "removes lasting rate errors, such as trim"),
    ("pid_rate", "kd"): (
        "PWM counts per deg/s²",
        "turns the loop forward against the motors' lag and the filters'",
    ),
    ("pid_attitude", "kp"): ("deg/s per deg", "sets how fast the angle follows"),
    ("pid_attitude", "ki"): (
        "deg/s per deg s",
        "removes the lean of the attitude filter and trim",
    ),
    ("pid_attitude", "kd"): (
        "deg/s per deg/s",
        "pushes at once when the setpoint moves, ahead of the motors' lag",
    ),
}


def gain_meaning(name: str) -> tuple[str, str]:
    """(unit, meaning) of one of the firmware's gains."""
    return _MEANINGS[name.split(".")[0], name.split("_")[-1]]
