"""From bench runs, or runs with measured rotor speed, to a model with its motor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from groundstation.dynamics.model import Model, with_motor
from groundstation.dynamics.vehicle import MotorConstants, Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.airborne import turning_parts
from groundstation.identification.division import LAST, hold_out
from groundstation.identification.fit_record import (
    Evidence,
    Identified,
    Progress,
    effect_terms,
    fitted_effects,
    silent,
    unit_of,
    with_effects,
)
from groundstation.identification.motor.figures import motor_pictures
from groundstation.identification.motor.fit import (
    MotorFit,
    bench_run,
    delay_in_words,
    fit_motor,
    simulate_run,
    validate_motor,
)
from groundstation.identification.motor.problem import EFFECTS, MotorRun
from groundstation.identification.motor.supply import (
    LAG,
    SAG,
    SupplyEstimate,
    estimate_supply,
    fit_motor_and_supply,
    supply_terms,
)
from groundstation.identification.preparation import bench_preparation
from groundstation.identification.runs import Run, require_known
from groundstation.identification.segments import EVERYTHING, Selection, selected
from groundstation.telemetry.samples import spans

START_S, PIECE_S = 0.5, 2.0
SUPPLY_DOUBT = (
    "the intervals do not contain the supply model's own error, some 0.5 %; a stiff bench supply"
    " has none"
)
KNOWN = (*EFFECTS, LAG, SAG)


def identify_motor(
    runs: Sequence[Run],
    held: Sequence[Run],
    before: Model,
    vehicle: Vehicle,
    effects: Sequence[str] = (),
    motor: int = 0,
    selection: Selection = EVERYTHING,
    progress: Progress = silent,
) -> Identified:
    """a0, a1, a2 from bench recordings, or from recordings with measured rotor speed.

    held: what no fit sees (none: the last third). motor: which one carries the bench's gate;
    where speeds were recorded in flight, each rotor is fitted.
    """
    fit_on, apart = _turning(runs, selection), ""
    if held:
        validate_on = _turning(held, selection)
    else:
        (fit_on, validate_on), apart = hold_out(fit_on), LAST
    measured = any(np.isfinite(run.rotor_rev_s).any() for run in fit_on)
    _require_known(effects, measured)
    if measured:
        from groundstation.identification.motor.flown import identify_rotors

        names = fitted_effects(effects, before, tuple(EFFECTS))
        return identify_rotors(fit_on, validate_on, apart, before, names, str(selection), progress)
    names = fitted_effects(effects, before, KNOWN)
    supplied = [name for name in names if name in (LAG, SAG)]
    progress(0.1, "fitting the motor")
    supplies: list[SupplyEstimate] = []
    if supplied:
        fit, supplies = fit_motor_and_supply(fit_on, vehicle, motor, names)
    else:
        fit = fit_motor([bench_run(run, motor) for run in fit_on], names)
    driven = [_driven(run, fit.motor, vehicle, motor, supplied) for run in validate_on]
    progress(0.8, "judging it on held-out data")
    delay = fit.estimates["delay_s"]
    drawn = [(run, simulate_run(run, fit.motor, delay, fit.values)) for run in driven[:4]]
    traces, residuals = motor_pictures(drawn, sum(len(run) for run in fit_on))
    terms = [*effect_terms(fit.estimates, unit_of), *supply_terms(supplied, supplies, vehicle)]
    account = {
        "what": "motor",
        "method": "prediction error" + (", supply modelled" if supplied else ""),
        "samples": sum(len(run) for run in fit_on),
        "selection": str(selection),
        "held_out": apart,
        **_found(fit, driven),
        "residual_tests": {one.channel: one.as_dict() for one in residuals},
        "supply": [one.as_dict() for one in supplies],
        "findings": [delay_in_words(fit.estimates)],
        "warnings": [*fit.warnings, *([SUPPLY_DOUBT] if supplied else [])],
    }
    model = msgspec.structs.replace(
        with_motor(before, fit.motor), effects=with_effects(before, terms)
    )
    prepared = bench_preparation(fit_on, motor)
    evidence = Evidence({"motor": fit.estimates}, traces, residuals, (), prepared)
    return Identified(model, account, evidence)


def _found(fit: MotorFit, validate_on: Sequence[MotorRun]) -> dict[str, Any]:
    """What the fit says, and how well it predicts either part."""
    delay = fit.estimates["delay_s"]
    figures = [
        (run.name, *validate_motor(run, fit.motor, delay, fit.values)) for run in validate_on
    ]
    return {
        "estimates": fit.estimates.as_dict(),
        "rejected_readings": fit.rejected,
        "identification": {
            "rotor_rms_rev_s": list(fit.rms_rev_s),
            "rotor_fit_percent": list(fit.fit_percent),
        },
        "validation": [
            {"recording": name, "rotor_fit_percent": percent, "rotor_rms_rev_s": error}
            for name, percent, error in figures
        ],
    }


def _require_known(effects: Sequence[str], measured: bool) -> None:
    """Raises BadInputError for an effect that cannot be fitted along."""
    unknown = sorted(set(effects) - set(KNOWN))
    if unknown:
        raise BadInputError(f"--with {', '.join(unknown)}: the motor fit knows {', '.join(KNOWN)}")
    pointless = [name for name in effects if name in (LAG, SAG)]
    if pointless and measured:
        raise BadInputError(
            f"--with {', '.join(pointless)}: needs bench recordings, on which all motors are"
            " driven alike"
        )


def _driven(
    run: Run, constants: MotorConstants, vehicle: Vehicle, motor: int, supplied: Sequence[str]
) -> MotorRun:
    """A bench run at the voltage that drives the motor: duty times the battery's, reported, or as
    the effects ``supplied`` say it is at the motors."""
    bench = bench_run(run, motor)
    if not supplied:
        return bench
    supply = estimate_supply(run, constants, vehicle, supplied)
    return replace(bench, voltage_mv=1000.0 * run.duty[:, motor] * supply.motors_v)


def _turning(runs: Sequence[Run], selection: Selection) -> list[Run]:
    """The stretches with turning motors, without their start; of these, what is selected."""
    for run in runs:
        require_known(run, ("duty",), "the motor needs it")
    parts = [
        part[round(START_S / part.period_s) :]
        for run in runs
        for part in turning_parts(run, PIECE_S)
    ]
    if selection != EVERYTHING:
        parts = [
            part[first:last]
            for part in parts
            for first, last in spans(selected(part, selection))
            if (last - first) * part.period_s >= PIECE_S
        ]
    if not parts:
        names = ", ".join(sorted({run.name for run in runs}))
        wanted = "" if selection == EVERYTHING else f" while {selection}"
        raise BadInputError(
            f"{names}: the motors never turn for {PIECE_S:.0f} s{wanted}; record with motors"
            " running"
        )
    return parts
