"""From flights to a model with its body and the effects fitted along."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
import numpy as np

from groundstation.dynamics.model import EffectTerm, Estimate, Model, rotor_motors, with_motor
from groundstation.dynamics.registry import DELAY, EFFECTS, SPIN_UP, at_stage
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.body.certainty import between_rows, unseen
from groundstation.identification.body.fit import BodyFit, fit_body, vertical
from groundstation.identification.body.judgement import EVERY_SETTING
from groundstation.identification.body.setup import FIT_WITH, SUPPLY_EFFECTS, on_other
from groundstation.identification.body.validation import (
    SHAKEN_S,
    predicted_rates,
    prediction_residuals,
    validate_body,
)
from groundstation.identification.division import divided
from groundstation.identification.fit_record import (
    TOLD,
    Evidence,
    Identified,
    Progress,
    ResidualTest,
    Trace,
    along_term,
    effect_terms,
    fitted_effects,
    liveliest,
    residual_test,
    silent,
    unit_of,
    with_effects,
)
from groundstation.identification.likelihood.on_board import (
    ON_BOARD,
    filter_terms,
    filters_of,
)
from groundstation.identification.likelihood.parameters import ALONG, SENSOR_LAG
from groundstation.identification.motor.supply import SAG, SupplyEstimate, supply_terms, undo_supply
from groundstation.identification.preparation import flight_preparation
from groundstation.identification.runs import Run
from groundstation.identification.segments import EVERYTHING, Selection
from groundstation.identification.stretches import Stretch, paced, quicker, stretches_of
from groundstation.identification.torque import by_saturation
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

AHEAD_S, DRAWN_S = 0.02, 3.0
KNOCK_G = 4.0
"""What no thrust gives a craft, and rotors that shake an unfiltered accelerometer hardly do."""
OF_THE_MOTORS = {effect.name for stage in ("supply", "motor") for effect in at_stage(stage)}
TESTED_ROWS = 50
"""Held-out residuals from which their correlations tell anything: twice the tests' lags."""
UNTESTED = "the residuals are not tested: the held-out stretch is no longer than their filter"


def identify_body(
    runs: Sequence[Run],
    held: Sequence[Run],
    before: Model,
    vehicle: Vehicle,
    effects: Sequence[str] = (),
    tie_roll_pitch: bool = False,
    measured: bool = False,
    selection: Selection = EVERYTHING,
    progress: Progress = silent,
) -> Identified:
    """c0, c1, c2, thrust_per_mass and the effects fitted along, from flights.

    before: the motor, with its covariance where it was identified, and effects that act already:
    what this fit knows of them is fitted again. held: what no fit sees (none: ``division``).
    measured: recorded rotor speeds instead of the motor model.
    """
    names = _names(effects, before, measured)
    supplied = [name for name in names if name in SUPPLY_EFFECTS]
    steered, saturated = (runs, []) if measured else by_saturation(runs)
    runs = steered or runs
    progress(0.0, "simulating the motors")
    stretches, supplies = _stretches(runs, before, vehicle, supplied, measured, selection)
    if held:
        fit_on, apart = stretches, ""
        validate_on, _ = _stretches(held, before, vehicle, supplied, measured, selection)
    else:
        fit_on, validate_on, apart = divided(stretches, vehicle.configuration)
    progress(0.2, "fitting the body")
    covariance = None if measured else motor_covariance(before)
    known_motor = measured or "motor" in before.fit or before.motor != vehicle.motor
    fit = fit_body(fit_on, vehicle, names, tie_roll_pitch, covariance, known_motor)
    validate_on = [paced(one, fit.pace[0]) for one in validate_on]
    progress(0.8, "judging it on held-out data")
    rows = sum(len(stretch) for stretch in fit_on)
    traces, residuals = _pictures(validate_on, fit, rows)
    account: dict[str, Any] = {
        "what": "body",
        "method": "prediction error, each flight's own noise spectrum",
        "rotor_speed": "measured" if measured else "modelled",
        "samples": rows,
        "rate_hz": 1.0 / runs[0].period_s,
        "selection": str(selection),
        "held_out": apart,
        **_found(fit, fit_on, validate_on),
        "residual_tests": {one.channel: one.as_dict() for one in residuals},
        "supply": [one.as_dict() for one in supplies],
        "warnings": [
            *fit.warnings,
            *(f"{one.name}: left out, a motor is saturated in most rows" for one in saturated),
            *knocks([*fit_on, *validate_on]),
            *_of_the_motors(fit, exact=covariance is None and not measured),
            *([] if residuals else [UNTESTED]),
        ],
    }
    terms = supply_terms(supplied, supplies, _profile(before, vehicle))
    prepared = flight_preparation(fit_on, vehicle.configuration)
    evidence = Evidence({"body": fit.estimates}, traces, residuals, (), prepared)
    return Identified(_fitted(before, vehicle, fit, terms), account, evidence)


def _found(
    fit: BodyFit, fit_on: Sequence[Stretch], validate_on: Sequence[Stretch]
) -> dict[str, Any]:
    """What the fit says, and how well it predicts either part. record: what tells a constant that
    flying otherwise does not."""
    told_not = fit.not_identified.keys()
    return {
        "estimates": fit.estimates.as_dict(),
        "fitted_along": {key: _stated(*found) for key, found in fit.nuisances.items()},
        "left_out": _left_out(fit),
        "motor_pace": _stated(*fit.pace),
        "not_identified": fit.not_identified,
        "record": dict.fromkeys(between_rows(fit.setup).keys() & told_not, EVERY_SETTING),
        "crossed": list(fit.crossed),
        "identification": validate_body(fit_on, fit),
        "validation": validate_body(validate_on, fit),
    }


def _names(effects: Sequence[str], before: Model, measured: bool) -> tuple[str, ...]:
    """The effects that are fitted along. Raises BadInputError for one that cannot be."""
    pointless = [name for name in effects if name in OF_THE_MOTORS]
    if pointless and measured:
        raise BadInputError(
            f"--with {', '.join(pointless)}: with measured rotor speeds it does not matter what"
            " drives the motors"
        )
    known = [name for name in FIT_WITH if not (measured and name in OF_THE_MOTORS)]
    return fitted_effects(effects, before, known)


def knocks(stretches: Sequence[Stretch]) -> list[str]:
    """The hardest knock of each recording that the samples used do not hold, in words."""
    lines = []
    for name in dict.fromkeys(one.run.name for one in stretches):
        here = [one for one in stretches if one.run.name == name]
        hardest, at_s = 0.0, 0.0
        for run in {id(one.run): one.run for one in here}.values():
            force = np.linalg.norm(np.nan_to_num(run.accelerometer), axis=1) / STANDARD_GRAVITY
            for one in here:
                if one.run is run:
                    force[one.rows] = 0.0
            row = int(force.argmax())
            if force[row] > hardest:
                hardest, at_s = force[row], run.time_s[row] - run.recording_start_s
        if hardest > KNOCK_G:
            lines.append(
                f"{name}: a knock of {hardest:.1f} g at {at_s:.1f} s, a landing or a collision, is"
                " not fitted"
            )
    return lines


def _left_out(fit: BodyFit) -> list[str]:
    """Effects that flights show beyond chance and that the model does not have, by name."""
    told = [
        key.partition(".")[0]
        for key, (size, error) in fit.nuisances.items()
        if key in (DELAY, SPIN_UP) and size > TOLD * error
    ]
    return list(dict.fromkeys([*told, *fit.shown]))


def _of_the_motors(fit: BodyFit, exact: bool) -> Iterator[str]:
    """Warnings of what was done with the motor's constants, or not known of them."""
    if fit.pace[0] != 1.0:
        percent, doubt = 100.0 * (fit.pace[0] - 1.0), 100.0 * fit.pace[1]
        both = unseen(fit.setup.problem.flights)
        beside = ", which counts as well where rows do not show every setting" if both else ""
        yield (
            f"the motors answer {abs(percent):.0f} +- {doubt:.1f} %"
            f" {'faster' if percent > 0 else 'slower'} than the profile's{beside}: a0, a1, a2 of"
            " the model are changed by as much, which leaves their steady speeds"
        )
    if exact:
        yield (
            "the motor's constants are taken as exact: give a --model whose motor was fitted, and"
            " its uncertainty counts as well"
        )


def _stated(value: float, stderr: float) -> dict[str, float]:
    return {"value": value, "stderr": stderr}


def _fitted(before: Model, vehicle: Vehicle, fit: BodyFit, supply: Sequence[EffectTerm]) -> Model:
    """The model before with what was fitted, the lag of the rotors' sensor among it, and with the
    filters on board that the fit used."""
    terms = [*_terms(fit), *supply]
    # With the lag that the motors' fit found their constants belong together, and PWM turns them.
    told = any(term.name == ALONG.effect for term in before.effects)
    if SENSOR_LAG in fit.nuisances and not told:
        terms += along_term(*fit.nuisances[SENSOR_LAG])
    if fit.setup.problem.frame.gyro_filter_hz > 0.0:
        terms += filter_terms(filters_of(vehicle, fit.setup.problem.flights))
    kept = tuple(term for term in before.effects if term.name not in ON_BOARD)
    return msgspec.structs.replace(
        with_motor(before, quicker(before.motor, fit.pace[0])),
        body=fit.body,
        effects=with_effects(msgspec.structs.replace(before, effects=kept), terms),
    )


def motor_covariance(model: Model) -> Array | None:
    """Covariance (3, 3) of a0, a1, a2, where the model says how its motor was identified."""
    estimates = model.fit.get("motor", {}).get("estimates", {})
    if not {"a0", "a1", "a2"} <= set(estimates.get("names", ())):
        return None
    places = [estimates["names"].index(name) for name in ("a0", "a1", "a2")]
    return np.asarray(estimates["covariance"], np.float64)[np.ix_(places, places)]


def _stretches(
    runs: Sequence[Run],
    before: Model,
    vehicle: Vehicle,
    supplied: Sequence[str],
    measured: bool,
    selection: Selection,
) -> tuple[list[Stretch], list[SupplyEstimate]]:
    supplies: list[SupplyEstimate] = []
    if supplied:
        runs, supplies = undo_supply(
            runs, rotor_motors(before), _profile(before, vehicle), supplied
        )
    return stretches_of(runs, rotor_motors(before), measured, selection), supplies


def _profile(before: Model, vehicle: Vehicle) -> Vehicle:
    """The profile, with the wires' resistance of the model where it has one."""
    for term in before.effects:
        if term.name == SAG:
            ohm = term.parameters["resistance_ohm"].value
            battery = msgspec.structs.replace(vehicle.battery, supply_ohm=ohm)
            return msgspec.structs.replace(vehicle, battery=battery)
    return vehicle


def _terms(fit: BodyFit) -> list[EffectTerm]:
    """Effects as models hold them; a mismatched rotor by its number."""
    found = []
    for term in effect_terms(fit.estimates, unit_of):
        if EFFECTS[term.name].choice is not None:
            (which,) = (keys[0].choice for keys in fit.setup.variants if keys[0].choice)
            rotor = Estimate(float(which), None, "")
            term = EffectTerm(term.name, {"rotor": rotor, **term.parameters})
        found.append(term)
    return found


def _pictures(
    stretches: Sequence[Stretch], fit: BodyFit, fitted_rows: int
) -> tuple[list[Trace], list[ResidualTest]]:
    """Rates predicted 20 ms ahead where they are liveliest, vertical force, and residuals."""
    stretch = max(stretches, key=len)
    period = stretch.run.period_s
    setup = on_other(fit.setup, [stretch])
    ((measured, predicted),) = predicted_rates(fit, setup, fit.saved, AHEAD_S)
    first = stretch.last - len(measured)
    time = stretch.run.time_s[first : stretch.last] - stretch.run.recording_start_s
    traces, residuals = [], []
    for axis, name in enumerate(AXES):
        rows = liveliest(measured[:, axis], period, DRAWN_S)
        traces.append(
            Trace(
                f"{name} rate",
                "deg/s",
                time[rows],
                np.degrees(measured[rows, axis]),
                np.degrees(predicted[rows, axis]),
                f"predicted {AHEAD_S * 1e3:.0f} ms ahead",
            )
        )
    force, squares = vertical(setup, fit.saved)
    if len(force):
        width = max(1, round(SHAKEN_S / period))
        force, squares = (
            np.convolve(one, np.ones(width) / width, "valid") for one in (force, squares)
        )
        times = stretch.run.time_s[stretch.rows][width // 2 :] - stretch.run.recording_start_s
        rows = liveliest(squares, period, 2 * DRAWN_S)
        traces.append(
            Trace(
                "vertical specific force",
                "m/s^2",
                times[rows],
                force[rows],
                fit.body.thrust_per_mass * squares[rows],
                "from the rotors alone; both averaged over 50 ms, as the rotors shake the sensor",
            )
        )
    configuration = setup.problem.frame.vehicle.configuration
    torque = stretch.squares.mixed(configuration)[stretch.rows]
    left = prediction_residuals(stretch, fit)
    for axis, name in enumerate(AXES):
        good = np.isfinite(left[:, axis])
        if good.sum() < TESTED_ROWS:
            continue
        residuals.append(
            residual_test(
                f"{name} rate",
                left[good, axis],
                f"{name} u'",
                torque[good, axis],
                fitted_rows,
            )
        )
    return traces, residuals
