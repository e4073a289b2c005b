"""``find_discrepancy``: from flights and a model to names, sizes and their proof."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import msgspec
import numpy as np

from groundstation.comparison.comparison import Judged, compare
from groundstation.comparison.consistency import (
    broken_rotor_sensors,
    missing_channel,
    require_channels,
    require_consistent,
)
from groundstation.comparison.gap import CHANNELS, FURTHER_EVERY_S
from groundstation.discrepancy.acceptance import NAMED, WEIGHED, Last, base_changes, refusal
from groundstation.discrepancy.disturbances import with_disturbance, with_imbalance
from groundstation.discrepancy.proof import (
    UNPROVEN,
    Candidate,
    EffectFound,
    Findings,
    FittedRows,
    NotShown,
    Predictions,
    Proof,
    Reason,
    Verdict,
    bare,
    prove,
)
from groundstation.discrepancy.recurrence import (
    BY_MASS,
    DELAY,
    UNWEIGHED,
    Recurrence,
    asked_again,
    last_blocks,
    recurrences,
    with_differences,
    with_open_delay,
    with_unmeasured,
)
from groundstation.discrepancy.screening import Evidence, Scored, leftover
from groundstation.discrepancy.search import (
    Judge,
    SearchState,
    answer_to_predictions,
    search_effects,
    to_follow,
)
from groundstation.dynamics.effect import CANDIDATES
from groundstation.dynamics.model import PROFILE, Model, model_vehicle
from groundstation.dynamics.registry import EFFECTS
from groundstation.errors import BadInputError
from groundstation.identification.body import identify_body
from groundstation.identification.body_setup import open_delay_s, unseen, unseen_delay_s
from groundstation.identification.estimate import inverse, require_results
from groundstation.identification.flight import (
    LEAST_AIR_S,
    LEAST_S,
    SETTLE_S,
    Flight,
    Span,
    best_way,
    cut,
    excitation,
    prepare,
    turning,
)
from groundstation.identification.likelihood.motion import (
    ALONG,
    BODY_KEYS,
    MOTOR_KEYS,
    SENSOR_LAG,
    VARIANTS,
    Point,
    Prior,
    Variant,
    absent,
    body_prior,
    estimates_of,
    joined,
    lag_of_reports,
    model_of,
    own_of,
    point_of,
)
from groundstation.identification.likelihood.problem import BASE_KEYS, Problem, in_plane_hz
from groundstation.identification.runs import Run, mostly_saturated, without_gaps
from groundstation.report.page import Result
from groundstation.telemetry.arrays import AXES, Array

# Which runs are fitted, and which are held out and judged.


PIECE_S = LEAST_AIR_S + SETTLE_S
LONG_S = 3.0 * PIECE_S
"""Of a piece that begins in the air, whose flight begins half a second later, and of a recording
whose thirds are such pieces."""
END_SHARE = 0.45
"""Of a shorter one, for rows that may be low are left out of its end."""


@dataclass(frozen=True, slots=True)
class Division:
    """fit_on: runs. judged: the held-out rows as parts of whole runs, whose rows before only tell a
    state. what: which rows are held out, in words."""

    fit_on: list[Run]
    judged: list[Judged]
    what: str


@dataclass(frozen=True, slots=True)
class _Air:
    """A run between its first and its last row with turning motors.

    first: that row. moved: what moves the craft (n, 4) from there on, its mean where they stand in
    between. seconds: in which they turn.
    """

    run: Run
    first: int
    moved: Array
    seconds: float

    @property
    def energy(self) -> Array:
        """Of what moves the craft (4,), over time."""
        away = self.moved - self.moved.mean(axis=0) if len(self.moved) else self.moved
        return (away**2).sum(axis=0) * self.run.period_s

    def with_ground(self, spans: Sequence[Span]) -> list[Span]:
        """Spans of these rows as spans of the run, the outer ones with what is on the ground."""
        end, last = len(self.moved), len(self.run)
        return [(a + self.first if a else 0, b + self.first if b < end else last) for a, b in spans]


def divide(
    flights: Sequence[Sequence[Run]], held: Sequence[Sequence[Run]], configuration: str
) -> Division:
    """Hold out ``held``, or else a third of each recording (``flight.best_way``) that is
    long enough for it; where none is, a whole recording.

    flights, held: the runs of each recording. Raises BadInputError where nothing can be held out.
    """
    every = [run for part in flights for run in part]
    if held:
        return _given(every, [run for part in held for run in part], "")
    flown = [[_flown(run, configuration) for run in part] for part in flights]
    seconds = [sum(one.seconds for one in part) for part in flown]
    if not any(seconds):  # that nothing flies is told by what is asked next
        return _given(every, every, "")
    long = [part for part, one in zip(flown, seconds, strict=True) if one >= LONG_S]
    if not long:
        return _whole(flown, seconds)
    period_s = min(one.run.period_s for part in long for one in part)
    moved = [np.vstack([one.moved for one in part]) for part in long]
    way = best_way(moved, LEAST_S / period_s)
    fit_on = [
        run for part, one in zip(flights, seconds, strict=True) if one < LONG_S for run in part
    ]
    judged = []
    for part in long:
        cuts = cut(way, [len(one.moved) for one in part])
        for one, (fitted, spans) in zip(part, cuts, strict=True):
            fit_on += [one.run[a:b] for a, b in one.with_ground(fitted)]
            judged += [Judged(one.run, a, b) for a, b in one.with_ground(spans)]
    which = "" if len(long) == len(flights) else f" of those of {LONG_S:.0f} s and more"
    return Division(fit_on, judged, way + which)


def _given(fit_on: list[Run], held: list[Run], what: str) -> Division:
    """Whole runs on either side."""
    return Division(fit_on, [Judged(run, 0, len(run)) for run in held], what)


def _whole(flown: Sequence[Sequence[_Air]], seconds: Sequence[float]) -> Division:
    """Short flights: the recording is held out whose excitation divides best, of one alone its
    last seconds."""
    if len(flown) < 2:
        return _end(flown[0], seconds[0])
    energy = np.array([sum(one.energy for one in part) for part in flown])
    share = energy / np.maximum(energy.sum(axis=0), 1e-300)
    most = int(np.argmax(np.minimum(share, 0.5 * (1.0 - share)).min(axis=1)))
    fit_on = [one.run for number, part in enumerate(flown) if number != most for one in part]
    rest = [one.run for one in flown[most]]
    return _given(fit_on, rest, f"all of {rest[0].name}")


def _end(part: Sequence[_Air], seconds: float) -> Division:
    """A short recording whose longest run leaves the fit as much as is judged."""
    longest = max(part, key=lambda one: one.seconds)
    run, name = longest.run, longest.run.name
    if longest.seconds < 2.0 * PIECE_S:
        raise BadInputError(
            f"{name}: of {seconds:.1f} s in the air none can be held out to be judged on; give"
            f" another flight with --validate, or one of {LONG_S:.0f} s"
        )
    held_s = max(PIECE_S, END_SHARE * longest.seconds)
    edge = longest.first + len(longest.moved) - round(held_s / run.period_s)
    fit_on = [one.run for one in part if one is not longest]
    judged = [Judged(run, edge, len(run))]
    return Division([*fit_on, run[:edge]], judged, f"last {held_s:.1f} s")


def _flown(run: Run, configuration: str) -> _Air:
    whole = without_gaps(run)
    moved, flying = excitation(whole, configuration), turning(whole)
    if not flying.any():
        return _Air(run, 0, moved[:0], 0.0)
    moved[~flying] = moved[flying].mean(axis=0)
    first, last = np.flatnonzero(flying)[[0, -1]].tolist()
    seconds = float(flying.sum()) * run.period_s
    return _Air(run, first, moved[first : last + 1], seconds)


# What of recordings a search can use: flights with every channel that is needed, that PWM steers,
# and rotor sensors that follow it.


Groups = Sequence[Sequence[Sequence[Run]]]
"""To be fitted and held out, of recordings, of runs."""


def usable(groups: Groups, model: Model) -> tuple[list[list[list[Run]]], list[str]]:
    """The groups without what a search cannot use, and what was left out, in words.

    Raises BadInputError where all of a group are of no use, and one for want of a channel.
    """
    useful, useless = _without_useless(groups)
    require_channels([run for group in useful for part in group for run in part])
    sound, broken = _without_broken_sensors(useful, model)
    return sound, [*useless, *broken]


def _without_useless(groups: Groups) -> tuple[list[list[list[Run]]], list[str]]:
    """Runs without those that tell nothing, where others of their group are left, and what was left
    out."""
    kept: list[list[list[Run]]] = []
    warnings: list[str] = []
    for group in groups:
        parts = [[(run, _useless(run)) for run in part] for part in group if part]
        if not any(why is None for part in parts for _, why in part):
            kept.append([[run for run, _ in part] for part in parts])
            continue
        rest = [[run for run, why in part if why is None] for part in parts]
        kept.append([part for part in rest if part])
        for part in parts:
            alone = all(why is not None for _, why in part)
            lines = [f"{_called(run, alone)}: left out, {why}" for run, why in part if why]
            warnings += lines[:1] if alone else lines
    return kept, warnings


def _useless(run: Run) -> str | None:
    """Why a search has nothing of a run."""
    missing = missing_channel(run)
    if missing is not None:
        return f"{missing} is not in the recording"
    return "a motor is saturated in most rows" if mostly_saturated(run) else None


def _called(run: Run, alone: bool) -> str:
    """A recording, or one run of it by its seconds."""
    first = run.start_s - run.recording_start_s
    return run.name if alone else f"{run.name}, {first:.0f} to {first + run.seconds:.0f} s"


def _without_broken_sensors(
    groups: Groups, model: Model
) -> tuple[list[list[list[Run]]], list[str]]:
    """Runs without rotor speeds that do not follow PWM and voltage, and what was left out."""
    warnings: dict[str, str] = {}

    def mended(run: Run) -> Run:
        broken = broken_rotor_sensors(run, model)
        if not broken:
            return run
        motors = " and ".join(f"M{rotor + 1}" for rotor in broken)
        warnings[run.name] = (
            f"{run.name}: the measured speed of {motors} does not follow its PWM and voltage (a"
            " dead sensor, or its column is another motor's): rotor speeds are taken from the motor"
            " model"
        )
        return replace(run, rotor_rev_s=np.full_like(run.rotor_rev_s, np.nan))

    mended_groups = [[[mended(run) for run in part] for part in group] for group in groups]
    return mended_groups, list(warnings.values())


# The lag of the sensor behind recorded rotor speeds: its name, where the given model has none.
#
# Wherever rows show speeds it is fitted along with the base constants, and so no candidate that
# joins. In the end it is weighed as one that did: against the fit without it, through the same
# gates. One that the model has stays as it was given (``Problem.base_keys``).


def add_sensor_lag(search: SearchState) -> None:
    """The sensor's lag as one of the effects of a search, or refused."""
    final = search.now
    if SENSOR_LAG not in final.keys:
        return
    (evidence,) = search.weighed(final, [ALONG])
    why = refusal(WEIGHED, evidence)
    if why is None:
        search.accepted.append(evidence)
    else:
        search.refused[ALONG.label] = why
    size, error = final.point[SENSOR_LAG], final.stderr()[SENSOR_LAG]
    search.held_out[ALONG.label] = evidence.held_out
    search.scores.append(Scored(ALONG, evidence.drop, np.array([size]), np.array([error])))


# What a search came to, told: effects with their evidence, candidates, what could not be shown.


SHOWN = 5.0
"""An effect can be shown when its usual size is so many standard errors."""


def conclude(
    search: SearchState,
    errors: Mapping[str, float],
    recurrence: Mapping[str, Recurrence],
    model: Model,
    lost: dict[str, str],
    warnings: list[str],
) -> Findings:
    """The findings, but for what predictions say of the verdict.

    errors: standard errors by key that are told. recurrence: by label. lost: as in ``Findings``.
    """
    problem, point, residual = search.problem, search.now.point, search.residual
    own = problem.frame.own
    given = tuple(key for variant in search.known for key in variant.keys)
    named, possible = _named_and_possible(search, recurrence)
    others = [one for one in search.accepted if one not in named]
    unnamed = (*given, *(key for one in others for key in one.variant.keys))

    def told(one: Evidence, order: int) -> EffectFound:
        again = recurrence.get(one.variant.label)
        return EffectFound(
            name=one.variant.effect,
            order=order,
            adds=one.variant.definition.adds,
            parameters=estimates_of(one.variant, point, errors),
            evidence={
                "likelihood_ratio": one.drop,
                "t": one.t,
                "held_out": one.held_out,
                "held_out_expected": one.expected,
            },
            alternatives=again.instead if again else (),
            gap=UNPROVEN,
            channels=tuple(CHANNELS[c] for c in one.channels),
            recurrence=again.share if again else None,
        )

    keys, effects, models = unnamed, [], []
    for order, one in enumerate(named, 1):
        keys = (*keys, *one.variant.keys)
        effects.append(told(one, order))
        models.append(model_of(point, errors, keys, model, own))
    warnings += _not_measured(problem, model, effects)
    verdict = Verdict.EFFECTS_FOUND
    if not effects:
        is_left = residual.verdict == "structured"
        verdict = Verdict.UNEXPLAINED if is_left else Verdict.NO_DISCREPANCY
    moved = model_of(point, errors, unnamed, model, own)
    changed = _with_renamed(search)
    return Findings(
        verdict=verdict,
        effects=tuple(effects),
        models=tuple(models),
        possible=tuple(told(one, 0).doubted(search.refused[one.variant.label]) for one in possible),
        base=model,
        given=model,
        moved=moved,
        base_changes=base_changes(
            problem, search.now, changed, errors, (*BODY_KEYS, *MOTOR_KEYS, *given)
        ),
        model=models[-1] if models else moved,
        candidates=tuple(_candidates(search)),
        not_shown=tuple(_not_shown(search.scores, {effect.name for effect in effects})),
        lost=lost,
        residual=residual,
        warnings=tuple(warnings),
    )


def _not_measured(problem: Problem, model: Model, effects: Sequence[EffectFound]) -> Iterator[str]:
    if not problem.known_motor:
        yield (
            "the model has no bench covariance for a0, a1, a2: 2 % each is assumed, and small"
            " effects of voltage are taken for it"
        )
    sizes = [one for effect in effects for one in effect.parameters.values()]
    if model.vehicle_profile is None and any(one.unit.startswith(BY_MASS) for one in sizes):
        yield (
            f"sizes in kg and N are for the mass of the profile,"
            f" {1e3 * model_vehicle(model).mass_kg:.3g} g, and their errors hold"
            f" {100.0 * UNWEIGHED:g} % for it: weigh the craft, and fit with --mass"
        )


def _with_renamed(search: SearchState) -> Point:
    """The point with constants moved by the accepted effects that are another name for it."""
    changed = dict(search.now.point)
    for one in search.accepted:
        rename = one.variant.definition.renames
        if rename is not None:
            given, size = search.problem.start[rename.constant], changed[one.variant.sizes[0]]
            changed[rename.constant] = rename.moved(given, size)
    return changed


def open_of(flights: Sequence[Flight]) -> float:
    """Delay (s) that the rows of these flights leave open; measured rotor speeds know what the
    controller did within a row."""
    modelled = [flight for flight in flights if not flight.rotor_measured]
    return max(
        (max(open_delay_s(one.period_s), unseen_delay_s(one.run)) for one in modelled), default=0.0
    )


def _named_and_possible(
    search: SearchState, recurrence: Mapping[str, Recurrence]
) -> tuple[list[Evidence], list[Evidence]]:
    """Effects that pass the last gates, and those that are no more than possible; why the others
    have no name is in ``search.refused`` then."""
    open_s = open_of(search.problem.flights)
    named, possible = [], []
    for one in search.accepted:
        label = one.variant.label
        last = Last(
            one.variant,
            search.now,
            open_s,
            recurrence[label].share if label in recurrence else 1.0,
            search.errors,
            search.weights.get(label),
        )
        why = refusal(NAMED, last)
        if why is None:
            named.append(one)
            continue
        search.refused[label] = why
        if why.reason is not Reason.NEGLIGIBLE:
            possible.append(one)
    return named, possible


def _candidates(search: SearchState) -> Iterator[Candidate]:
    fitted = {one.variant.label for one in search.accepted}
    for one in search.scores:
        label = one.variant.label
        why, held_out = search.refused.get(label), search.held_out.get(label, 0.0)
        found = Candidate(label, one.drop, one.t, held_out, label in fitted)
        yield found if why is None else found.refused(why)


def _not_shown(scores: Sequence[Scored], named: Container[str]) -> list[NotShown]:
    """Effects whose usual size would be lost in the noise of these recordings; no named ones."""
    found = []
    for one in scores:
        if one.variant.effect in named:
            continue
        effect = one.variant.definition
        sizes = (unknown for unknown in one.variant.unknowns if unknown.parameter.kind == "size")
        for unknown, error in zip(sizes, one.errors.tolist(), strict=True):
            if SHOWN * error > unknown.worth:
                name, unit = unknown.key.partition(".")[2], unknown.unit
                stderr = error if math.isfinite(error) else None
                found.append(
                    NotShown(effect.name, name, stderr, unknown.worth, unit, effect.excited_by)
                )
    return found


# Find what a model is missing: ``find_discrepancy`` is the entry.


Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is done, 0..1 (negative: as before)."""

MEASURED_ROTORS = "rotor speeds are measured: the motors' part is in them"
STEPS_KEPT = 16
"""Of a proof, which has a model a step."""
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
    SHOWN_BY: ClassVar[str] = "groundstation.discrepancy.report:discrepancy"

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
    fit_base: bool = False,
    progress: Progress | None = None,
) -> Discrepancy:
    """Find, name and add what ``model`` is missing, and prove it on samples that decided nothing.

    recordings: the runs of each (``runs.flights_of``). validation: recordings that are the
    proof, and touch neither names nor sizes; none: parts of the others (``division``). own: effects
    of the user's own as further candidates. left_out: what of the recordings has no runs, in words
    (``runs.flights_of_each``). fit_base: the body of ``model`` is a profile's; fit it first, on the
    samples that choose names.

    Raises BadInputError where no recording has gyro, PWM and battery voltage, no flight, no motion,
    or where the model is of another craft.
    """
    report: Progress = progress or (lambda what, share: None)
    report("comparing", 0.05)
    model = bare(model)  # what is slow is another on every day
    (recordings, validation), unused = usable((recordings, validation), model)
    parts = divide(recordings, validation, model_vehicle(model).configuration)
    said = [*left_out, *unused]
    if fit_base:
        report("fitting the body", 0.0)
        model, doubts = _with_fitted_body(parts.fit_on, model)
        said += doubts
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
    said += [*driven.values(), *findings.warnings]
    findings = replace(
        findings,
        given=with_disturbance(model, train.before),
        model=with_disturbance(findings.model, train.of(findings.model)),
        warnings=tuple(said),
    )
    findings, proof = prove(findings, train, proof_rows)
    return Discrepancy(findings, proof, parts.what)


def _with_fitted_body(fit_on: Sequence[Run], model: Model) -> tuple[Model, list[str]]:
    """The model of a profile with the body that these rows show, and what is to be said of it. What
    no fit tells stays the profile's, for a fit never blocks a search."""
    vehicle = model_vehicle(model)
    runs = [without_gaps(run) for run in fit_on]
    measured = all(np.isfinite(run.rotor_rev_s).all() for run in runs)
    try:
        found = identify_body(runs, (), model, vehicle, measured=measured)
        doubts = require_results(found.account, model, vehicle)
    except BadInputError as error:
        origin = {"motor": PROFILE, "body": PROFILE}
        told = f"the body could not be fitted, and is the profile's in the improved model: {error}"
        return msgspec.structs.replace(model, origin=origin), [told]
    names = [{"file": name} for name in dict.fromkeys(run.name for run in runs)]
    fitted = found.documented(recordings=names, held_out=found.account["held_out"])
    return fitted, doubts


def find_effects(
    flights: Sequence[Run],
    model: Model,
    *,
    judged: FittedRows | None = None,
    own: Sequence[Variant] = (),
    progress: Progress | None = None,
) -> Findings:
    """Find, name and fit the effects that ``model`` is missing in ``flights``.

    flights: rows that were lost may be NaN (see ``runs.flights_of``); each of them is left
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
    start = point_of(model)
    theirs = own_of(model)
    every_own = joined(theirs, own)
    problem = Problem(fit_on, model, start, every_own, motors_told=not unseen(fit_on))
    given_constants = body_prior(model, start)
    problem.prior.append(given_constants)
    problem.settle_filters()
    shown = lag_of_reports(fit_on, problem.start, problem.frame)
    if shown is not None:
        problem.prior.append(shown)
    lost = _lost(fit_on)
    known = [v for v in VARIANTS if any(start.get(k, absent(k)) != absent(k) for k in v.keys)]
    known += theirs
    there = {v.effect for v in known}
    corner = in_plane_hz(model_vehicle(model), fit_on, there)
    problem.frame = replace(problem.frame, accelerometer_filter_hz=corner)
    sought = (v for v in (*VARIANTS, *every_own) if v.definition.role in CANDIDATES)
    candidates = [v for v in sought if v.effect not in {*lost, *there}]
    search = SearchState(problem, known, candidates, report)

    def model_at(point: Point) -> Model:
        given = tuple(key for one in known for key in one.keys)
        tried = (key for one in (*candidates, *search.renames) for key in one.keys)
        keys = (*given, *(key for key in tried if key in point))
        return model_of(point, {}, keys, model, every_own)

    search_effects(search)
    if judged is not None:
        slow = to_follow(judged.of(model_at(search.now.point)))
        if answer_to_predictions(search, Judge(judged, model_at, slow)):
            search.residual = leftover(problem, search.now)
    add_sensor_lag(search)
    warnings = _require_told(search, given_constants)
    report("choosing again on resamples", 0.95)
    final = search.now
    told = [one.variant for one in search.accepted if {*final.keys}.issuperset(one.variant.sizes)]
    columns = [one for one in candidates if {*problem.every_key}.issuperset(one.sizes)]
    others = asked_again(columns, search.refused, told)
    late = [one for one in columns if DELAY in one.keys and one not in (*told, *others)]
    blocks = last_blocks(problem, final, [*others, *late])
    recurrence = recurrences(blocks, final.point, told, others)
    search.errors = with_differences(search.errors, blocks)
    stated = with_unmeasured(
        with_open_delay(search.errors, blocks, open_of(fit_on)),
        final.point,
        row_s=max(flight.period_s for flight in fit_on),
        is_weighed=model.vehicle_profile is not None,
        motors_known=problem.known_motor or all(flight.rotor_measured for flight in fit_on),
    )
    found = conclude(search, stated, recurrence, model, lost, warnings)
    return with_imbalance(found, problem, final.point)


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


def _require_told(search: SearchState, known: Prior) -> list[str]:
    """Refuse recordings without motion; what is only weak is returned as warnings.

    known: what the model says of its constants, which is no motion.
    """
    names = ", ".join(sorted({f.run.name for f in search.problem.flights}))
    first = search.first
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
