"""From flights to a model with its body, and how well that predicts flights it has not seen."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
import numpy as np

from groundstation.dynamics.model import EffectTerm, Estimate, Model, rotor_motors, with_motor
from groundstation.dynamics.registry import DELAY, EFFECTS, SPIN_UP, at_stage
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.body.fit import EVERY_SETTING, BodyFit, fit_body, vertical
from groundstation.identification.body.setup import (
    FIT_WITH,
    SUPPLY_EFFECTS,
    Setup,
    between_rows,
    on_other,
    unseen,
)
from groundstation.identification.division import Stretch, divided, paced, quicker, stretches_of
from groundstation.identification.estimate import fit_percent, rms
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
from groundstation.identification.likelihood.motion import ALONG, SENSOR_LAG, Point
from groundstation.identification.likelihood.problem import ON_BOARD, filter_terms, filters_of
from groundstation.identification.likelihood.spectra import minimum_phase_whitener
from groundstation.identification.motor.workflow import (
    SAG,
    SupplyEstimate,
    flight_preparation,
    supply_terms,
    undo_supply,
)
from groundstation.identification.runs import EVERYTHING, Run, Selection, by_saturation
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

# What past errors of a body model foretell of those to come: trim, air, noise of the sensor.
#
# The sum of the next rows' errors is regressed on fading memories of the errors up to now. Flights
# differ in what they foretell (air, speed, balance), so the weights start as those of the flights
# that were fitted and are learnt on, every half a second, from the flight's own past; no row of
# the future counts.


Learnt = tuple[Array, Array]
"""Normal matrix (m, m) and right-hand side (m,) of the regression, sums over rows."""

MEMORIES_S = (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 2.0)
"""Fading times; the first is the last row alone."""
EVERY_S = 0.5
FITTED_S = 2.0
"""The flights that were fitted count as so much of the flight's own past."""
RIDGE = 1e-4
"""Memories of similar length are alike."""


def learnt(series: Sequence[Array], rows: int, period_s: float) -> Learnt:
    """What whole flights' errors (n,) show, as ``FITTED_S`` of one flight."""
    size = len(MEMORIES_S)
    normal, score, seen = np.zeros((size, size)), np.zeros(size), 0
    for errors in series:
        memories, sums = _memories(errors, rows, period_s), _sums(errors, rows)
        normal += memories.T @ memories
        score += memories.T @ sums
        seen += len(sums)
    share = FITTED_S / (max(seen, 1) * period_s)
    return share * normal, share * score


def foretold(errors: Array, rows: int, period_s: float, before: Learnt) -> Array:
    """Sums (n + 1 - rows,) of the next ``rows`` errors, as they are expected before each of them
    (n,), and after the last that has as many to come."""
    memories, sums = _memories(errors, rows, period_s), _sums(errors, rows)
    normal, score = before
    block = max(1, round(EVERY_S / period_s))
    made = np.zeros(len(sums))
    for first in range(0, len(sums), block):
        made[first : first + block] = memories[first : first + block] @ _solved(normal, score)
        # By the next block these sums are over.
        over = slice(max(0, first - rows), max(0, first + block - rows))
        normal = normal + memories[over].T @ memories[over]
        score = score + memories[over].T @ sums[over]
    return made


def _solved(normal: Array, score: Array) -> Array:
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0.0] = 1.0
    ridge = RIDGE * np.eye(len(score))
    return np.linalg.solve(normal / np.outer(scale, scale) + ridge, score / scale) / scale


def _sums(errors: Array, rows: int) -> Array:
    total = np.concatenate([[0.0], np.cumsum(errors)])
    return total[rows:] - total[:-rows]


def _memories(errors: Array, rows: int, period_s: float) -> Array:
    """Fading means (n + 1 - rows, m) of the errors before each row, for as many as have
    ``rows`` to come."""
    from scipy.signal import lfilter

    found = np.zeros((len(errors) + 1, len(MEMORIES_S)))
    for i, memory in enumerate(MEMORIES_S):
        keep = math.exp(-period_s / memory) if memory else 0.0
        found[1:, i] = lfilter([1.0 - keep], [1.0, -keep], errors)
    return found[: len(errors) + 1 - rows]


# How well a body model predicts flights it has not seen.


HORIZONS_S = (0.02, 0.05)
SHAKEN_S = 0.05
"""The rotors shake the accelerometer by many times what the craft does: means are compared."""


def validate_body(stretches: Sequence[Stretch], fit: BodyFit) -> dict[str, float]:
    """Held-out figures: per axis the RMS errors at one row, 20 and 50 ms (rad/s) and the fit %
    at 20 and 50 ms, and both for the vertical specific force (m/s^2, means over 50 ms). They are
    those of the model that is saved: what was fitted along and left out does not help it."""
    figures: dict[str, float] = {}
    setup = on_other(fit.setup, stretches)
    for horizon in (0.0, *HORIZONS_S):
        label = f"{horizon * 1e3:.0f}ms" if horizon else "1row"
        pairs = predicted_rates(fit, setup, fit.saved, horizon)
        measured = np.vstack([one for one, _ in pairs])
        modelled = np.vstack([other for _, other in pairs])
        for axis, name in enumerate(AXES):
            figures[f"gyro_{name}_rms_{label}"] = rms(measured[:, axis] - modelled[:, axis])
            if horizon:
                figures[f"gyro_{name}_fit_percent_{label}"] = fit_percent(
                    measured[:, axis], modelled[:, axis]
                )
    measured, squares = vertical(setup, fit.saved)
    rows = max(1, round(SHAKEN_S / stretches[0].run.period_s))
    if len(measured) >= 2 * rows:
        measured, squares = (_means(one, rows) for one in (measured, squares))
        modelled = fit.body.thrust_per_mass * squares
        figures["accelerometer_z_rms"] = rms(measured - modelled)
        figures["accelerometer_z_fit_percent"] = fit_percent(measured, modelled)
    return figures


def predicted_rates(
    fit: BodyFit, setup: Setup, point: Point, horizon_s: float = 0.0
) -> list[tuple[Array, Array]]:
    """(measured, predicted) rates (k, 3) in rad/s of each flight, predicted ``horizon_s`` before.

    A prediction starts at a measured rate and knows nothing of the future but the motors' inputs:
    the air's moment stays as it is, and what has turned the craft beside the model goes on as
    the errors of the past foretell (``foretelling``). The shortest horizon is one row, the first
    prediction belongs to row ``horizon``.
    """
    period = setup.problem.flights[0].period_s
    rows = max(1, round(horizon_s / period))
    fitted = fit.setup.residuals(point)
    before = [learnt([one[:, axis] for one in fitted], rows, period) for axis in range(3)]
    found = []
    lasting, residuals = setup.slow_moments(point), setup.residuals(point)
    for flight, left, slow in zip(setup.problem.flights, residuals, lasting, strict=True):
        measured = flight.run.gyro[flight.first - 1 : flight.last]
        expected = np.column_stack(
            [foretold(left[:, axis], rows, period, before[axis]) for axis in range(3)]
        )
        expected += rows * np.vstack([slow[:1], slow[:-1]])[: len(expected)]
        sums = np.vstack([np.zeros(3), np.cumsum(left + slow, axis=0)])
        wrong = sums[rows:] - sums[:-rows] - expected
        found.append((measured[rows:], measured[rows:] - period * wrong))
    return found


def prediction_residuals(stretch: Stretch, fit: BodyFit) -> Array:
    """One-step errors (n, 3) of a fit, whitened by the mean spectrum of the flights it was made
    on, in standard deviations; the first rows are NaN, all where the stretch is shorter than the
    whitener."""
    (left,) = on_other(fit.setup, [stretch]).residuals(fit.point)
    out = np.full(left.shape, np.nan)
    for axis in range(3):
        whitener = minimum_phase_whitener(fit.free, axis)
        if len(left) >= len(whitener):  # numpy exchanges the two where it is shorter
            out[len(whitener) - 1 :, axis] = np.convolve(left[:, axis], whitener, "valid")
    return out


def _means(values: Array, rows: int) -> Array:
    """Means over blocks of so many rows."""
    whole = len(values) // rows * rows
    return values[:whole].reshape(-1, rows).mean(axis=1)


# From flights to a model with its body and the effects fitted along.


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
