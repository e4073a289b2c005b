"""From bench runs, or runs with measured rotor speed, to a model with its motor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import Model
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.evidence import (
    Evidence,
    Identified,
    Progress,
    ResidualTest,
    Trace,
    effect_terms,
    fitted_effects,
    liveliest,
    residual_test,
    silent,
    unit_of,
    with_effects,
)
from groundstation.identification.excitation import motor_excitation
from groundstation.identification.motor import (
    MotorFit,
    bench_run,
    credible_rows,
    fit_motor,
    measured_run,
    simulate_run,
    validate_motor,
)
from groundstation.identification.motor_problem import EFFECTS, MotorRun
from groundstation.identification.runs import Run, flying, hold_out
from groundstation.identification.segments import EVERYTHING, Selection, selected
from groundstation.identification.supply import (
    LAG,
    SAG,
    SupplyEstimate,
    estimate_supply,
    fit_motor_and_supply,
    supply_terms,
)
from groundstation.spans import spans

Array = NDArray[np.float64]

START_S, PIECE_S = 0.5, 2.0
DRAWN_S = 6.0
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
    where speeds were measured, all four are used.
    """
    unknown = sorted(set(effects) - set(KNOWN))
    if unknown:
        raise BadInputError(f"--with {', '.join(unknown)}: the motor fit knows {', '.join(KNOWN)}")
    fit_on, validate_on = _parts(
        _turning(runs, selection), _turning(held, selection) if held else []
    )
    measured = bool(np.isfinite(fit_on[0].rotor_rev_s).any())
    pointless = [name for name in effects if name in (LAG, SAG)]
    if pointless and measured:
        raise BadInputError(
            f"--with {', '.join(pointless)}: needs bench recordings, on which all motors are"
            " driven alike"
        )
    names = fitted_effects(effects, before, tuple(EFFECTS) if measured else KNOWN)
    supplied = [name for name in names if name in (LAG, SAG)]
    progress(0.1, "looking at the excitation")
    judged = motor_excitation(_motor_runs(fit_on, motor, measured))
    progress(0.2, "fitting the motor")
    supplies: list[SupplyEstimate] = []
    if supplied:
        fit, supplies = fit_motor_and_supply(fit_on, vehicle, motor, names)
        driven = []
        for run in validate_on:
            supply = estimate_supply(run, fit.motor, vehicle, supplied)
            voltage = 1000.0 * run.duty[:, motor] * supply.motors_v
            driven.append(replace(bench_run(run, motor), voltage_mv=voltage))
    else:
        fit = fit_motor(_motor_runs(fit_on, motor, measured), names)
        driven = _motor_runs(validate_on, motor, measured)
    progress(0.8, "judging it on held-out data")
    delay = fit.estimates["delay_s"]
    figures = [(run.name, *validate_motor(run, fit.motor, delay, fit.values)) for run in driven]
    traces, residuals = _pictures(driven, fit, sum(len(run) for run in fit_on))
    terms = [*effect_terms(fit.estimates, unit_of), *supply_terms(supplied, supplies, vehicle)]
    account = {
        "what": "motor",
        "method": "prediction error" + (", supply modelled" if supplied else ""),
        "samples": sum(len(run) for run in fit_on),
        "selection": str(selection),
        "excitation": judged.as_dict(),
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
        "residual_tests": {one.channel: one.as_dict() for one in residuals},
        "supply": [
            {"lag_s": s.lag_s, "cell_ohm": s.cell_ohm, "report_rms_v": s.rms_v} for s in supplies
        ],
        "warnings": [*judged.lines, *fit.warnings, *([SUPPLY_DOUBT] if supplied else [])],
    }
    model = msgspec.structs.replace(before, motor=fit.motor, effects=with_effects(before, terms))
    return Identified(model, account, Evidence({"motor": fit.estimates}, traces, residuals))


def _parts(runs: list[Run], held: list[Run]) -> tuple[list[Run], list[Run]]:
    return (runs, held) if held else hold_out(runs)


def _turning(runs: Sequence[Run], selection: Selection) -> list[Run]:
    """The stretches with turning motors, without their start; of these, what is selected."""
    for run in runs:
        if not np.isfinite(run.duty).all():
            raise BadInputError(f"{run.name}: the PWM is missing in some rows")
    parts = [
        part[round(START_S / part.period_s) :] for run in runs for part in flying(run, PIECE_S)
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


def _motor_runs(runs: Sequence[Run], motor: int, measured: bool) -> list[MotorRun]:
    if measured:
        return [measured_run(run, index) for run in runs for index in range(4)]
    return [bench_run(run, motor) for run in runs]


def _pictures(
    runs: Sequence[MotorRun], fit: MotorFit, fitted_rows: int
) -> tuple[list[Trace], list[ResidualTest]]:
    """Measured and simulated speed, and the residuals, of the first held-out runs."""
    traces, residuals = [], []
    for run in runs[:4]:
        model = simulate_run(run, fit.motor, fit.estimates["delay_s"], fit.values)
        readings = np.isfinite(run.rev_s)
        rows = liveliest(run.voltage_mv, run.period_s, DRAWN_S)
        here = np.flatnonzero(readings[rows]) + rows.start
        traces.append(
            Trace(
                f"rotor speed, {run.name}",
                "rev/s",
                run.period_s * here,
                run.rev_s[here],
                model[here],
                "simulated from the voltage alone",
            )
        )
        good = credible_rows(run, model)
        residuals.append(
            residual_test(
                f"rotor speed, {run.name}",
                run.rev_s[good] - model[good],
                "armature voltage",
                run.voltage_mv[good],
                fitted_rows,
            )
        )
    return traces, residuals
