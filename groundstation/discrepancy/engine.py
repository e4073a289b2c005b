"""Find what a model is missing: the entry of the search."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.findings import (
    CHANNELS,
    Alternative,
    Candidate,
    ChannelResidual,
    Findings,
    FoundEffect,
    Leftover,
    NotShown,
    Verdict,
)
from groundstation.discrepancy.flight import Flight, prepare
from groundstation.discrepancy.judge import negligible
from groundstation.discrepancy.leftover import leftover
from groundstation.discrepancy.own_candidates import OwnEffect, joined, own_terms
from groundstation.discrepancy.physics import spin_rotors
from groundstation.discrepancy.problem import BASE_KEYS, Fit, Problem, bounded
from groundstation.discrepancy.search import Accepted, Outcome, Scored, search
from groundstation.discrepancy.unknowns import (
    BODY_KEYS,
    LOW_PASS,
    VARIANTS,
    Variant,
    absent,
    estimates_of,
    model_of,
    own_variant,
    point_of,
)
from groundstation.dynamics.effects.catalogue import EFFECTS
from groundstation.dynamics.model import Estimate, Model
from groundstation.errors import BadInputError
from groundstation.identification.estimate import inverse
from groundstation.identification.runs import Run, hold_out

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is done, 0..1 (negative: as before)."""

AXES = ("roll", "pitch", "yaw")
SHOWN = 5.0
"""An effect can be shown when its usual size is so many standard errors."""
HARDLY_MOVED = 0.5
"""Standard error over value of c0, c1, c2 from which a recording tells nothing."""
OTHER_CRAFT, OTHER_ROTORS_DEG = 1.4, 25.0
"""c0 and c1 so far from the profile's (in the logarithm), or axes turned so far, are another
craft's."""
DROWNED, DROWNED_ANYWHERE = 0.05, 0.01
"""An effect that explains less than this share of the structure that is left in the channels it
touches, or in all of them, is not believed."""
USUAL: dict[str, float] = {
    LOW_PASS: 1 / (2 * np.pi * 30.0),
    "motor_braking_asymmetry.factor": 0.4,
    **{f"rotor_mismatch.{i}": 0.05 for i in (1, 2, 3, 4)},
    **{f"centre_of_gravity_offset.{a}_m": 5e-4 for a in "xy"},
    **{f"gyro_bias.{a}_dps": 1.0 for a in "xyz"},
    **{f"accelerometer_bias.{a}_g": 0.03 for a in "xyz"},
    **{f"imu_misalignment.{a}_deg": 2.0 for a in ("roll", "pitch", "yaw")},
    **{f"imu_lever_arm.{a}_m": 0.003 for a in "xyz"},
}
"""Sizes worth finding where the catalogue's default is not one."""
NEEDS_ACCELEROMETER = (
    "accelerometer_bias",
    "rotor_drag",
    "velocity_moment",
    "climb_inflow",
    "imu_lever_arm",
    "ground_effect",
    "attitude_filter_lean",
)
NEEDS_ATTITUDE = (
    "gyro_bias",
    "attitude_filter_lean",
    "rotor_drag",
    "velocity_moment",
    "climb_inflow",
)
NEEDS_MODELLED_ROTORS = (
    "motor_dead_voltage",
    "motor_braking_asymmetry",
    "supply_sag",
    "battery_reading_lag",
)


def find_effects(
    flights: Sequence[Run],
    model: Model,
    validation: Sequence[Run] | None = None,
    *,
    own: Sequence[OwnEffect] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> Findings:
    """Find, name and fit the effects that ``model`` is missing in ``flights``.

    flights: to fit on; rows that were lost may be NaN (see ``recordings.flights_of``).
    validation: rows that no fit sees; None: the last third of the flights. own: effects of the
    user's own as further candidates. seed: kept for what is drawn; nothing in the search is.

    Raises BadInputError where there is no gyro, no flight, no motion, or the model is of another
    craft.
    """
    report: Progress = progress or (lambda what, share: None)
    if validation is None:
        flights, validation = hold_out(flights)
    report("preparing the flights", 0.0)
    fit_on, held = prepare(flights), prepare(validation)
    start = point_of(model)
    theirs, _ = own_terms(model)
    every_own = joined(theirs, own)
    problem = Problem(fit_on, model, start, every_own)
    problem.settle_filters()
    lost = _lost([*fit_on, *held])
    known = [v for v in VARIANTS if any(start.get(k, absent(k)) != absent(k) for k in v.keys)]
    known += [own_variant(one) for one in theirs]
    there = {v.effect for v in known}
    candidates = [*VARIANTS, *map(own_variant, every_own)]
    candidates = [v for v in candidates if v.effect not in lost and v.effect not in there]
    outcome = search(problem, held, known, candidates, report)
    warnings = _require_told(outcome, problem)
    report("judging what is left", 0.95)
    residual = _what_is_left(outcome, problem, held, known)
    return _findings(outcome, problem, held, model, known, lost, residual, warnings)


def _what_is_left(
    outcome: Outcome, problem: Problem, held: Sequence[Flight], known: Sequence[Variant]
) -> Leftover:
    """Judge the residual; effects that are small beside an unexplained structure are taken back.

    A pendulum under the craft, say, also looks a little like a lever arm: a name for a hundredth
    of what is wrong is no explanation.
    """
    vehicle = problem.frame.vehicle
    while True:
        final = outcome.final
        speeds = [spin_rotors(f, final.point, vehicle).end[f.rows].mean() for f in problem.flights]
        residual, slow = leftover(problem, final, held, float(np.mean(speeds)))
        drowned = [one for one in outcome.accepted if _drowned(one, slow)]
        if not drowned:
            return residual
        for one in drowned:
            outcome.accepted.remove(one)
            outcome.reasons[one.variant.label] = "small beside a structure that nothing explains"
        gone = {key for one in drowned for key in one.variant.keys}
        point = {key: number for key, number in final.point.items() if key not in gone}
        outcome.final = problem.fit(point, [key for key in final.keys if key not in gone])


def _drowned(one: Accepted, slow: dict[int, float]) -> bool:
    touched = sum(slow.get(channel, 0.0) for channel in one.evidence.channels)
    return one.evidence.drop < max(DROWNED * touched, DROWNED_ANYWHERE * sum(slow.values()))


def _lost(flights: Sequence[Flight]) -> dict[str, str]:
    """Effects that no recording can show for want of a channel."""
    lost: dict[str, str] = {}
    if not any(f.has_accelerometer for f in flights):
        lost |= dict.fromkeys(NEEDS_ACCELEROMETER, "accelerometer")
    if not any(f.attitude is not None for f in flights):
        lost |= dict.fromkeys(NEEDS_ATTITUDE, "attitude")
    if all(f.rotor_measured for f in flights):
        lost |= dict.fromkeys(
            NEEDS_MODELLED_ROTORS, "rotor speeds are measured: the motors' part is in them"
        )
    return lost


def _require_told(outcome: Outcome, problem: Problem) -> list[str]:
    """Refuse recordings without motion, and a model of another craft; what is only weak is
    returned as warnings."""
    names = ", ".join(sorted({f.run.name for f in problem.flights}))
    total, linear = outcome.first_quadratic, outcome.first_linear
    at = linear.place(BASE_KEYS)
    errors = np.sqrt(np.diag(inverse(total.normal[np.ix_(at, at)])))
    still = [
        axis
        for axis, key in zip(AXES, BODY_KEYS[:3], strict=True)
        if errors[BASE_KEYS.index(key)] > HARDLY_MOVED * abs(linear.point[key])
    ]
    if len(still) == len(AXES):
        raise BadInputError(
            f"{names}: the craft hardly moved about any axis; these recordings cannot show what"
            " the model is missing: fly doublets or random steps about every axis"
        )
    # A fit of every effect at once: one alone may bend the constants to imitate another.
    moved = bounded(linear.point, linear.keys, inverse(total.normal) @ total.gradient)
    usual = problem.frame.vehicle.body_constants
    ratios = {k: moved[k] / c for k, c in zip(BODY_KEYS[:2], usual[:2], strict=True)}
    turned = abs(moved["imu_misalignment.yaw_deg"])
    if all(abs(np.log(max(r, 1e-3))) > OTHER_CRAFT for r in ratios.values()):
        words = ", ".join(f"{key} is {r:.2f} of the profile's" for key, r in ratios.items())
    elif turned > OTHER_ROTORS_DEG:
        words = f"roll and pitch are {turned:.0f} deg away from where its rotors would be"
    else:
        return [f"{axis} hardly moved: what acts on it cannot be told" for axis in still]
    raise BadInputError(
        f"{names}: the model does not belong to this craft ({words}); give the model that was"
        f" fitted for it, and the right --vehicle (now {problem.frame.vehicle.name})"
    )


def _findings(
    outcome: Outcome,
    problem: Problem,
    held: Sequence[Flight],
    model: Model,
    known: Sequence[Variant],
    lost: dict[str, str],
    residual: Leftover,
    warnings: list[str],
) -> Findings:
    final, errors = outcome.final, outcome.final.stderr()
    keys = tuple(key for v in known for key in v.keys)
    effects: list[FoundEffect] = []
    for one in outcome.accepted:
        keys = (*keys, *one.variant.keys)
        if not negligible(one.variant, final.point):
            effects.append(_effect(one, len(effects) + 1, final, keys, model, problem.frame.own))
    if not problem.known_motor:
        warnings.append(
            "the model has no bench covariance for a0, a1, a2: 2 % each is assumed, and small"
            " effects of voltage are taken for it"
        )
    verdict = Verdict.EFFECTS_FOUND
    if not effects and residual.verdict == "structured":
        verdict = Verdict.UNEXPLAINED
    elif not effects:
        verdict = Verdict.NO_DISCREPANCY
    return Findings(
        verdict=verdict,
        effects=tuple(effects),
        base=model,
        model=model_of(final.point, errors, keys, model, problem.frame.own),
        candidates=_candidates(outcome, {effect.name for effect in effects}),
        not_shown=tuple(_not_shown(outcome.first)),
        lost=lost,
        channels=_channels(problem, outcome, held),
        residual=residual,
        warnings=tuple(warnings),
    )


def _effect(
    one: Accepted,
    order: int,
    final: Fit,
    keys: tuple[str, ...],
    model: Model,
    own: Sequence[OwnEffect],
) -> FoundEffect:
    name, evidence = one.variant.effect, one.evidence
    return FoundEffect(
        name=name,
        order=order,
        parameters=estimates_of(one.variant, final.point, final.stderr()),
        evidence={
            "likelihood_ratio": evidence.drop,
            "t": evidence.t,
            "held_out": evidence.held_out,
            "held_out_expected": evidence.expected,
            "axes": evidence.spread(1)[0],
            "recordings": evidence.spread(0)[0],
        },
        alternatives=tuple(
            Alternative(other, margin, _manoeuvre(name, other, own)) for other, margin in one.rivals
        ),
        gap_before=one.gap[0],
        gap_after=one.gap[1],
        channels=tuple(CHANNELS[c] for c in evidence.channels),
        adds=one.variant.definition.adds,
        model=model_of(one.fit.point, one.fit.stderr(), keys, model, own),
    )


def _manoeuvre(name: str, other: str, own: Sequence[OwnEffect]) -> str:
    """What separates two effects, from the catalogue, whichever of the two knows it."""
    effects = {**EFFECTS, **{one.effect.name: one.effect for one in own}}
    for one, two in ((name, other), (other, name)):
        for confusion in effects[one].confused_with:
            if confusion.other == two:
                return confusion.manoeuvre
    return effects[other].excited_by


def _candidates(outcome: Outcome, named: set[str]) -> tuple[Candidate, ...]:
    fitted = {one.variant.label: one.variant.effect for one in outcome.accepted}
    accepted = {label for label, effect in fitted.items() if effect in named}
    found = []
    for one in outcome.first:
        label = one.variant.label
        parameters = {
            key.partition(".")[2]: Estimate(float(size + absent(key)), float(error), "")
            for key, size, error in zip(one.variant.keys, one.values, one.errors, strict=False)
        }
        reason = "" if label in accepted else outcome.reasons.get(label, "")
        if label in fitted and label not in accepted:
            reason = "within the rounding of the firmware's own bias: fitted, not an effect"
        found.append(
            Candidate(
                label,
                parameters,
                one.drop,
                one.t,
                outcome.held_out.get(label, 0.0),
                label in accepted,
                reason,
            )
        )
    return tuple(found)


def _not_shown(scores: Sequence[Scored]) -> list[NotShown]:
    """Effects whose usual size would be lost in the noise of these recordings."""
    found = []
    for one in scores:
        effect = one.variant.definition
        for key, error in zip(one.variant.keys, one.errors.tolist(), strict=False):
            name = key.partition(".")[2]
            usual = USUAL.get(key)
            if usual is None:
                usual = effect.parameter(name).default
            if SHOWN * error > usual:
                units = {p.name: p.unit for p in effect.parameters}
                found.append(
                    NotShown(
                        effect.name, name, error, usual, units.get(name, ""), effect.excited_by
                    )
                )
    return found


def _channels(
    problem: Problem, outcome: Outcome, held: Sequence[Flight]
) -> dict[str, ChannelResidual]:
    """Whitened RMS on held-out rows (fitted ones where nothing was held out)."""
    rows = held or problem.flights
    _, before, freedom = problem.cost(problem.start, rows)
    _, after, _ = problem.cost(outcome.final.point, rows)
    floor = _saturated(problem, outcome, rows)
    return {
        CHANNELS[c]: ChannelResidual(
            *(float(np.sqrt(part[c] / freedom[c])) for part in (before, after, floor))
        )
        for c in sorted(freedom)
    }


def _saturated(problem: Problem, outcome: Outcome, rows: Sequence[Flight]) -> dict[int, float]:
    """Whitened power of each channel with every effect at once, as fitted to the fitted rows."""
    change = inverse(outcome.quadratic.normal) @ outcome.quadratic.gradient
    linear = problem.linear(outcome.linear.point, problem.every_key, rows)
    power: dict[int, float] = {}
    for s in linear.spectra:
        left = s.residual - change[s.place] @ s.columns
        own = float((s.weight / problem.noise[s.channel].at(s.hz) * left**2).sum())
        power[s.channel] = power.get(s.channel, 0.0) + own
    return power
