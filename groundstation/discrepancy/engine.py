"""Find what a model is missing: ``find_discrepancy`` is the entry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from groundstation.comparison.comparison import compare
from groundstation.comparison.consistency import require_consistent
from groundstation.comparison.gap import FURTHER_EVERY_S
from groundstation.discrepancy.blocks import Blocks, last_blocks
from groundstation.discrepancy.conclusions import conclude, open_of
from groundstation.discrepancy.differences import (
    DELAY,
    with_differences,
    with_open_delay,
    with_unmeasured,
)
from groundstation.discrepancy.division import divide
from groundstation.discrepancy.findings import (
    Findings,
    Verdict,
)
from groundstation.discrepancy.imbalance import with_imbalance
from groundstation.discrepancy.judge import Judge, to_follow
from groundstation.discrepancy.proof import LEFT, FittedRows, Predictions, Proof, bare, prove
from groundstation.discrepancy.recurrence import asked_again, recurrences
from groundstation.discrepancy.rotor_sensor import with_sensor_lag
from groundstation.discrepancy.search import Outcome, concluded, search_effects
from groundstation.discrepancy.search_state import SearchState
from groundstation.discrepancy.slow_disturbance import with_disturbance
from groundstation.discrepancy.usable import usable
from groundstation.dynamics.effect import CANDIDATES
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.registry import EFFECTS
from groundstation.errors import BadInputError
from groundstation.identification.body.setup import unseen
from groundstation.identification.estimate import inverse
from groundstation.identification.flight import Flight, prepare
from groundstation.identification.likelihood.motion import (
    BODY_KEYS,
    RENAMES,
    VARIANTS,
    Point,
    Prior,
    Variant,
    absent,
    body_prior,
    joined,
    model_of,
    own_of,
    point_of,
)
from groundstation.identification.likelihood.problem import BASE_KEYS, Problem, in_plane_hz
from groundstation.identification.runs import Run
from groundstation.report.page import Result
from groundstation.telemetry.arrays import AXES

Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is done, 0..1 (negative: as before)."""

MEASURED_ROTORS = "rotor speeds are measured: the motors' part is in them"
STEPS_KEPT = 16
"""Of a proof, which has a model a step."""
LEAST_EXPLAINED = 0.1
"""Of the given model's squared excess over noise: what explains less of it explains nothing."""
HARDLY_MOVED = 0.5
"""Standard error over value of c0, c1, c2 from which a recording tells nothing."""


@dataclass(frozen=True, slots=True, repr=False)
class Discrepancy(Result):
    """What a model is missing, with the proof.

    held_out: which samples are the proof, in words; empty where whole recordings were given for it.
    """

    findings: Findings
    proof: Proof
    held_out: str = ""
    SHOWN_BY: ClassVar[str] = "groundstation.discrepancy.shown:discrepancy"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is doubtful, in words."""
        return self.findings.warnings

    def _what(self) -> str:
        names = ", ".join(one.name for one in self.findings.effects) or self.findings.verdict.value
        before, after = self.proof.before, self.proof.after
        return f"{names}; gap {before.gap:.2f}, after {after.beside(before):.2f}"


def find_discrepancy(
    recordings: Sequence[Sequence[Run]],
    model: Model,
    validation: Sequence[Sequence[Run]] = (),
    *,
    own: Sequence[Variant] = (),
    left_out: Sequence[str] = (),
    progress: Progress | None = None,
) -> Discrepancy:
    """Find, name and add what ``model`` is missing, and prove it on samples that decided nothing.

    recordings: the runs of each (``recordings.flights_of``). validation: recordings that are the
    proof, and touch neither names nor sizes; none: parts of the others (``division``). own: effects
    of the user's own as further candidates. left_out: what of the recordings has no runs, in words
    (``recordings.flights_of_each``).

    Raises BadInputError where no recording has gyro, PWM and battery voltage, no flight, no motion,
    or where the model is of another craft.
    """
    report: Progress = progress or (lambda what, share: None)
    report("comparing", 0.05)
    model = bare(model)  # what is slow is another on every day
    (recordings, validation), unused = usable((recordings, validation), model)
    parts = divide(recordings, validation, model_vehicle(model).configuration)
    train = Predictions(compare(parts.fit_on, model))
    proof_rows = Predictions(compare(parts.judged, model, train.before.black_box), kept=STEPS_KEPT)
    findings = find_effects(
        parts.fit_on,
        model,
        judged=FittedRows(train.before, FURTHER_EVERY_S),
        own=own,
        progress=lambda what, share: report(what, 0.1 + 0.7 * max(share, 0.0)),
    )
    report("proving it", 0.8)
    driven = {**train.before.warnings, **proof_rows.before.warnings}
    said = (*left_out, *unused, *driven.values(), *findings.warnings)
    findings = replace(
        findings,
        given=with_disturbance(model, train.before),
        model=with_disturbance(findings.model, train.of(findings.model)),
        warnings=said,
    )
    findings, proof = prove(findings, train, proof_rows)
    return Discrepancy(findings, proof, parts.what)


def find_effects(
    flights: Sequence[Run],
    model: Model,
    *,
    judged: FittedRows | None = None,
    own: Sequence[Variant] = (),
    progress: Progress | None = None,
) -> Findings:
    """Find, name and fit the effects that ``model`` is missing in ``flights``.

    flights: rows that were lost may be NaN (see ``recordings.flights_of``); each of them is left
    out once, and has to agree with what the others say. judged: the given model's predictions of
    them; what makes these worse is taken back; None: they are not asked. own: effects of the user's
    own as further candidates.

    Raises BadInputError where there is no gyro, no flight, no motion, or the model is of another
    craft.
    """
    report: Progress = progress or (lambda what, share: None)
    report("preparing the flights", 0.0)
    fit_on = prepare(flights)
    if judged is None:  # or else the comparison has asked
        require_consistent(list(flights), model)

    found = _searched(fit_on, model, judged, own, report)
    return found if judged is None else replace(found, verdict=_verdict(found, judged))


def _verdict(findings: Findings, judged: FittedRows) -> Verdict:
    """Unexplained where predictions leave more than noise, and what was found explains hardly any
    of it; no name is asked where nothing was left."""
    given, found = judged.before.gap, judged.judge(findings.model).gap
    if given <= LEFT or findings.verdict is Verdict.UNEXPLAINED:
        return findings.verdict
    explained = (given**2 - found**2) / (given**2 - 1.0)
    nameless = not findings.effects and (found > LEFT or findings.possible)
    if explained < LEAST_EXPLAINED or nameless:
        return Verdict.UNEXPLAINED
    return findings.verdict


def _searched(
    fit_on: Sequence[Flight],
    model: Model,
    judged: FittedRows | None,
    own: Sequence[Variant],
    report: Progress,
) -> Findings:
    """``find_effects`` without its verdict."""
    start = point_of(model)
    theirs = own_of(model)
    every_own = joined(theirs, own)
    problem = Problem(fit_on, model, start, every_own, motors_told=not unseen(fit_on))
    given_constants = body_prior(model, start)
    problem.prior.append(given_constants)
    problem.settle_filters()
    lost = _lost(fit_on)
    known = [v for v in VARIANTS if any(start.get(k, absent(k)) != absent(k) for k in v.keys)]
    known += theirs
    there = {v.effect for v in known}
    vehicle = model_vehicle(model)
    corner = in_plane_hz(vehicle, fit_on, there)
    problem.frame = replace(problem.frame, accelerometer_filter_hz=corner)
    out = {*lost, *there}
    candidates = [
        v
        for v in (*VARIANTS, *every_own)
        if v.effect not in out and v.definition.role in CANDIDATES
    ]
    search = SearchState(problem, known, candidates, report)
    given = tuple(key for variant in known for key in variant.keys)
    tried = [*candidates, *(one for one in RENAMES if one not in known)]

    def model_at(point: Point) -> Model:
        keys = (*given, *(key for one in tried for key in one.keys if key in point))
        return model_of(point, {}, keys, model, every_own)

    search_effects(search)
    if judged is not None:
        slow = to_follow(judged.of(model_at(search.now.point)))
        search.judge = Judge(judged, model_at, slow)
    outcome = with_sensor_lag(concluded(search), problem, search.folds)
    warnings = _require_told(outcome, problem, given_constants)
    report("choosing again on resamples", 0.95)
    final = outcome.final
    told = [one.variant for one in outcome.accepted if {*final.keys}.issuperset(one.variant.sizes)]
    columns = [one for one in candidates if {*problem.every_key}.issuperset(one.sizes)]
    others = asked_again(columns, outcome.refused, told)
    late = [one for one in columns if DELAY in one.keys and one not in (*told, *others)]
    blocks = last_blocks(problem, final, [*others, *late])
    recurrence = recurrences(blocks, final.point, told, others)
    outcome.errors = with_differences(outcome.errors, blocks)
    stated = _stated(outcome, blocks, problem, model)
    found = conclude(outcome, stated, recurrence, problem, model, known, lost, warnings)
    return with_imbalance(found, problem, final.point)


def _stated(outcome: Outcome, blocks: Blocks, problem: Problem, model: Model) -> dict[str, float]:
    """Standard errors by key, with what the flights leave open."""
    flights = problem.flights
    return with_unmeasured(
        with_open_delay(outcome.errors, blocks, open_of(flights)),
        outcome.final.point,
        row_s=max(flight.period_s for flight in flights),
        is_weighed=model.vehicle_profile is not None,
        motors_known=problem.known_motor or all(flight.rotor_measured for flight in flights),
    )


def _lost(flights: Sequence[Flight]) -> dict[str, str]:
    """Effects that no recording can show for want of a channel."""
    there = {
        "accelerometer": any(f.has_accelerometer for f in flights),
        "attitude": any(f.attitude is not None for f in flights),
        "modelled rotors": not all(f.rotor_measured for f in flights),
    }
    missing = [name for name, is_there in there.items() if not is_there]
    return {
        effect.name: MEASURED_ROTORS if name == "modelled rotors" else name
        for name in missing
        for effect in EFFECTS.values()
        if name in effect.needs and not effect.on_board
    }


def _require_told(outcome: Outcome, problem: Problem, known: Prior) -> list[str]:
    """Refuse recordings without motion; what is only weak is returned as warnings.

    known: what the model says of its constants, which is no motion.
    """
    names = ", ".join(sorted({f.run.name for f in problem.flights}))
    first = outcome.first
    at = first.place(BASE_KEYS)
    normal = first.total.normal[np.ix_(at, at)]
    weight, _, _ = known.at(first.point)
    own = [BASE_KEYS.index(key) for key in known.keys]
    normal[np.ix_(own, own)] -= weight
    errors = np.sqrt(np.maximum(np.diag(inverse(normal)), 0.0))
    still = [
        axis
        for axis, key in zip(AXES, BODY_KEYS[:3], strict=True)
        if errors[BASE_KEYS.index(key)] > HARDLY_MOVED * abs(first.point[key])
    ]
    if len(still) == len(AXES):
        raise BadInputError(
            f"{names}: the craft hardly moved about any axis; these recordings cannot show what"
            " the model is missing: fly doublets or random steps about every axis"
        )
    return [f"{axis} hardly moved: what acts on it cannot be told" for axis in still]
