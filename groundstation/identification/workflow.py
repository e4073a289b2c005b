"""From runs to a model and the account of how it was found, as model files hold it.

Each function takes runs to fit on and runs that no fit sees (none: the last third of what it
got), and returns the constants with a ``fit`` dictionary: method, samples, estimates with
covariance, errors on both parts, warnings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from groundstation.dynamics.model import ArxAxis, BodyConstants, EffectTerm, Estimate
from groundstation.dynamics.vehicle import MotorConstants, Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.arx import (
    AXES,
    Criterion,
    arx_data,
    prediction_rms,
    residuals,
    search_arx,
)
from groundstation.identification.body import (
    BodyFit,
    fit_body,
    fit_free_run,
    validate_body,
)
from groundstation.identification.body_terms import split, stretches_of
from groundstation.identification.motor import (
    MotorRun,
    bench_run,
    fit_motor,
    measured_run,
    validate_motor,
)
from groundstation.identification.residual_tests import cross_correlation_test, whiteness_test
from groundstation.identification.runs import Run, flying, hold_out
from groundstation.identification.supply import estimate_supply, fit_motor_and_supply

SUPPLY_EFFECTS = ("battery_reading_lag", "supply_sag")
"""``with`` names that make the motor fit undo the battery reading's lag and the wires' loss."""
START_S = 0.5
UNITS = {
    "dead_time": "s",
    "inertia_coupling": "",
    "rotor_gyroscopic_torque": "kg m^2",
    "rotor_acceleration_torque": "kg m^2",
}
TABLE_ROWS = 20


def identify_motor(
    runs: Sequence[Run],
    held: Sequence[Run],
    vehicle: Vehicle,
    effects: Sequence[str] = (),
    motor: int = 0,
) -> tuple[MotorConstants, dict[str, Any]]:
    """a0, a1, a2 from bench recordings, or from recordings with measured rotor speed.

    motor: which one carries the bench's gate; where speeds were measured, all four are used.
    """
    unknown = set(effects) - set(SUPPLY_EFFECTS)
    if unknown:
        raise BadInputError(
            f"--with {', '.join(sorted(unknown))}: the motor fit knows {', '.join(SUPPLY_EFFECTS)}"
        )
    fit_on, validate_on = _parts(_turning(runs), _turning(held) if held else [])
    measured = bool(np.isfinite(fit_on[0].rotor_rev_s).any())
    if effects and measured:
        raise BadInputError("--with supply effects: needs bench recordings (all motors alike)")
    if effects:
        fit, supplies = fit_motor_and_supply(fit_on, vehicle, motor)
        driven = []
        for run in validate_on:
            supply = estimate_supply(run, fit.motor, vehicle)
            voltage = 1000.0 * run.duty[:, motor] * supply.motors_v
            driven.append(replace(bench_run(run, motor), voltage_mv=voltage))
        method = "prediction error, supply modelled"
    else:
        fit = fit_motor(_motor_runs(fit_on, motor, measured))
        supplies, driven = [], _motor_runs(validate_on, motor, measured)
        method = "prediction error"
    delay = fit.estimates["delay_s"]
    judged = [(run.name, *validate_motor(run, fit.motor, delay)) for run in driven]
    return fit.motor, {
        "what": "motor",
        "method": method,
        "samples": sum(len(run) for run in fit_on),
        "estimates": fit.estimates.as_dict(),
        "rejected_readings": fit.rejected,
        "identification": {
            "rotor_rms_rev_s": list(fit.rms_rev_s),
            "rotor_fit_percent": list(fit.fit_percent),
        },
        "validation": [
            {"recording": name, "rotor_fit_percent": percent, "rotor_rms_rev_s": error}
            for name, percent, error in judged
        ],
        "supply": [
            {"lag_s": s.lag_s, "cell_ohm": s.cell_ohm, "report_rms_v": s.rms_v} for s in supplies
        ],
        "warnings": list(fit.warnings),
    }


def identify_body(
    runs: Sequence[Run],
    held: Sequence[Run],
    vehicle: Vehicle,
    motor: MotorConstants,
    effects: Sequence[str] = (),
    tie_roll_pitch: bool = False,
    measured: bool = False,
) -> tuple[BodyConstants, tuple[EffectTerm, ...], dict[str, Any]]:
    """c0, c1, c2, thrust_per_mass and the effects fitted along, from flights."""
    stretches = stretches_of(runs, motor, measured)
    if held:
        fit_on, validate_on = stretches, stretches_of(held, motor, measured)
    else:
        fit_on, validate_on = split(stretches)
    fit = fit_body(fit_on, vehicle, effects, tie_roll_pitch)
    naive = fit_free_run(fit_on, vehicle)
    return (
        fit.body,
        _effect_terms(fit),
        {
            "what": "body",
            "method": "prediction error, autoregressive noise",
            "rotor_speed": "measured" if measured else "modelled",
            "samples": sum(len(stretch) for stretch in fit_on),
            "estimates": fit.estimates.as_dict(),
            "identification": validate_body(fit_on, fit, vehicle),
            "validation": validate_body(validate_on, fit, vehicle),
            "naive_free_run": dict(zip(("c0", "c1", "c2"), naive.tolist(), strict=True)),
            "warnings": list(fit.warnings),
        },
    )


def identify_arx(
    runs: Sequence[Run],
    held: Sequence[Run],
    vehicle: Vehicle,
    motor: MotorConstants,
    criterion: Criterion = Criterion.FREE_RUN,
) -> tuple[dict[str, ArxAxis], dict[str, Any]]:
    """One ARX polynomial per axis, angle from u', with the table of the best structures."""
    air = [one.run[one.rows] for one in stretches_of(runs, motor)]
    fit_on, validate_on = _parts(
        air, [one.run[one.rows] for one in stretches_of(held, motor)] if held else []
    )
    found: dict[str, ArxAxis] = {}
    report: dict[str, Any] = {}
    warnings = []
    for axis in AXES:
        one, other = (
            [arx_data(run, axis, motor, vehicle.configuration) for run in part]
            for part in (fit_on, validate_on)
        )
        search = search_arx(one, other, criterion=criterion)
        chosen = search.chosen.axis
        left = residuals(chosen, other[0])
        white = whiteness_test(left)
        cross = cross_correlation_test(left, other[0].inputs[-len(left) :])
        found[axis] = chosen
        if not search.chosen.plausible:
            warnings.append(f"{axis}: the step response of the chosen model is not plausible")
        report[axis] = {
            "chosen": search.chosen.label,
            "stderr": search.chosen.stderr.tolist(),
            "rms_20ms_rad": prediction_rms(chosen, other, max(1, round(0.02 / chosen.ts))),
            "whiteness": {"passes": white.passes, "outside": white.outside},
            "cross_correlation": {"passes": cross.passes, "outside": cross.outside},
            "table": [
                {
                    "model": candidate.label,
                    "rms_identification_rad": candidate.rms_fit,
                    "rms_validation_rad": candidate.rms_validation,
                    "plausible_step": candidate.plausible,
                }
                for candidate in search.candidates[:TABLE_ROWS]
            ],
        }
    return found, {
        "what": "arx",
        "method": f"least squares, chosen by {criterion.value}",
        "samples": sum(len(run) for run in fit_on),
        "axes": report,
        "warnings": warnings,
    }


def _parts(runs: list[Run], held: list[Run]) -> tuple[list[Run], list[Run]]:
    return (runs, held) if held else hold_out(runs)


def _turning(runs: Sequence[Run]) -> list[Run]:
    """The stretches with turning motors, without their start."""
    parts = [part[round(START_S / part.period_s) :] for run in runs for part in flying(run, 2.0)]
    if not parts:
        names = ", ".join(sorted({run.name for run in runs}))
        raise BadInputError(f"{names}: the motors never turn for 2 s; record with motors running")
    return parts


def _motor_runs(runs: Sequence[Run], motor: int, measured: bool) -> list[MotorRun]:
    if measured:
        return [measured_run(run, index) for run in runs for index in range(4)]
    return [bench_run(run, motor) for run in runs]


def _effect_terms(fit: BodyFit) -> tuple[EffectTerm, ...]:
    terms = []
    for name, value, error in zip(
        fit.estimates.names, fit.estimates.values, fit.estimates.stderr, strict=True
    ):
        effect, dot, parameter = name.partition(".")
        if dot:
            estimate = Estimate(float(value), float(error), UNITS[effect])
            terms.append(EffectTerm(effect, {parameter: estimate}))
    return tuple(terms)
