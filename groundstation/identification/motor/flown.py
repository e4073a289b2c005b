"""From flights with recorded rotor speeds to a model with the motor of each rotor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from groundstation.dynamics.model import Model
from groundstation.dynamics.simulation import armature_mv, simulate_motor
from groundstation.dynamics.vehicle import MotorConstants, mean_motor
from groundstation.errors import BadInputError
from groundstation.identification.fit_record import (
    Evidence,
    Identified,
    Progress,
    along_term,
    effect_terms,
    unit_of,
    with_effects,
)
from groundstation.identification.motor.figures import motor_pictures
from groundstation.identification.motor.problem import COASTING, MotorRun
from groundstation.identification.motor.rotor_speed import rotor_readings
from groundstation.identification.motor.rotors import (
    RotorFit,
    fit_rotors,
    simulate_rotor,
    validate_rotor,
)
from groundstation.identification.runs import Run, require_known
from groundstation.telemetry.arrays import Array

Four = list[MotorRun | None]
"""What the sensors of M1..M4 show in one run; None for one that does not work."""

LEAST_S = 2.0
"""What is held out counts from this on; a simulation forgets its start in half a second."""
SWAP_S = 0.1
"""Over which changes of speed are compared between rotors: about a motor's time constant."""
SWAP_MARGIN = 0.2
"""By how much more a reading must go with another rotor's PWM than with its own."""
CLEARLY_BELOW, LEAST_BELOW = 0.8, 0.01
"""Voltage over what holds the speed below which a motor may coast, and the least share of rows with
so little: a1/a0 n bounds the back EMF from above, so nearer to it a motor may still be driven."""
TOLD = 3.0
"""Standard errors from which coasting is told from none."""


def identify_rotors(
    fit_on: Sequence[Run],
    validate_on: Sequence[Run],
    apart: str,
    before: Model,
    effects: Sequence[str],
    selection: str,
    progress: Progress,
) -> Identified:
    """a0, a1, a2 of each rotor, from its recorded speed and its duty times battery voltage.

    apart: which rows ``validate_on`` are in words, of those that were given to fit.

    Raises BadInputError where no sensor works, where rotors are swapped, and where the data do
    not tell the time constant.
    """
    flights, left_out = rotor_runs(fit_on)
    held, held_out = rotor_runs(validate_on)
    _require_in_order(flights, before.motor)
    progress(0.2, "fitting the motors")
    fit, coasting = _with_coasting(flights, held, before.motor, effects)
    progress(0.8, "judging them on held-out data")
    judged = _judged(held, fit)
    rows = sum(len(run) for run in fit_on)
    drawn = [
        (run, simulate_rotor(run, motor, fit.lag_s, fit.effects, tuple(fit.values.values())))
        for run, motor in judged[:4]
    ]
    traces, residuals = motor_pictures(drawn, rows)
    account: dict[str, Any] = {
        "what": "motor",
        "method": "prediction error of each rotor, free noise spectrum",
        "samples": rows,
        "selection": selection,
        "held_out": apart,
        "estimates": fit.estimates.as_dict(),
        "rotors": _rotors(fit),
        "findings": [*_findings(fit), coasting],
        "validation": [
            {"recording": run.name, "rotor_fit_percent": percent, "rotor_rms_rev_s": error}
            for run, motor in judged
            for percent, error in [validate_rotor(run, motor, fit)]
        ],
        "residual_tests": {one.channel: one.as_dict() for one in residuals},
        "warnings": [*dict.fromkeys([*left_out, *held_out]), *_warnings(fit)],
    }
    terms = [*effect_terms(fit.estimates, unit_of), *along_term(fit.lag_s, fit.lag_stderr_s)]
    model = msgspec.structs.replace(
        before,
        motor=mean_motor(fit.motors),
        motors=fit.motors,
        effects=with_effects(before, terms),
    )
    return Identified(model, account, Evidence({"motor": fit.estimates}, traces, residuals))


def _with_coasting(
    flights: Sequence[Four], held: Sequence[Four], motor: MotorConstants, effects: Sequence[str]
) -> tuple[RotorFit, str]:
    """The fit, with ``motor_coasting`` where the flights tell it and held-out speeds are predicted
    no worse by it; and what is known of it, in words."""
    without = fit_rotors(flights, motor, [name for name in effects if name != COASTING])
    below = _share_below(flights, without)
    if below < LEAST_BELOW:
        return without, (
            f"{COASTING}: not identified, because only {100 * below:.2g} % of the voltages are"
            f" below {CLEARLY_BELOW:g} of what holds the speed: the motors never had to brake hard"
        )
    fit = fit_rotors(flights, motor, list(dict.fromkeys([*effects, COASTING])))
    place = fit.estimates.names.index(f"{COASTING}.share")
    share, error = (
        100.0 * float(one[place]) for one in (fit.estimates.values, fit.estimates.stderr)
    )
    said = f"{COASTING}: {share:.0f} +- {error:.0f} % of a braking current does not flow"
    if COASTING in effects:
        return fit, said
    if share <= TOLD * error:
        return without, f"{said}: none is told"
    if _squares(held, fit) > _squares(held, without):
        return without, f"{said}, but held-out speeds are predicted worse with it: left out"
    return fit, said


def _squares(held: Sequence[Four], fit: RotorFit) -> float:
    """Sum of squared errors of held-out speeds."""
    judged = _judged(held, fit)
    return sum(len(run.rev_s) * validate_rotor(run, own, fit)[1] ** 2 for run, own in judged)


def _share_below(flights: Sequence[Four], fit: RotorFit) -> float:
    """Share of the rows whose voltage is clearly below what holds the mean speed."""
    below = [
        run.voltage_mv < CLEARLY_BELOW * np.exp(fit.shape[rotor, 0])
        for four in flights
        for rotor, run in enumerate(four)
        if run is not None
    ]
    return float(np.concatenate(below).mean())


def _judged(held: Sequence[Four], fit: RotorFit) -> list[tuple[MotorRun, MotorConstants]]:
    """What is held out and long enough, with the motor of its rotor."""
    return [
        (run, fit.motors[rotor])
        for four in held
        for rotor, run in enumerate(four)
        if run is not None and fit.told[rotor] and len(run.rev_s) * run.period_s > LEAST_S
    ]


def rotor_runs(runs: Sequence[Run]) -> tuple[list[Four], list[str]]:
    """The working sensors of each run, and in words which do not work.

    Raises BadInputError where PWM or battery voltage are missing.
    """
    found: list[Four] = []
    left_out: list[str] = []
    for run in runs:
        voltage = armature_mv(run.duty, run.supply_v)
        require_known(run, ("duty", "supply_v"), "the motors need it")
        readings = rotor_readings(run)
        left_out += readings.left_out
        nothing = np.zeros(len(run))
        found.append(
            [
                MotorRun(
                    f"{run.name} M{rotor + 1}",
                    run.period_s,
                    np.ascontiguousarray(voltage[:, rotor]),
                    readings.rev_s[:, rotor],
                    nothing,
                    nothing,
                )
                if np.isfinite(readings.rev_s[:, rotor]).any()
                else None
                for rotor in range(4)
            ]
        )
    return found, left_out


def _require_in_order(flights: Sequence[Four], motor: MotorConstants) -> None:
    """Raises BadInputError where rotors' readings follow each other's PWM, not their own."""
    from scipy.optimize import linear_sum_assignment

    products, squares = np.zeros((4, 4)), np.zeros((2, 4))
    for four in flights:
        if any(run is None for run in four):
            continue
        runs = [run for run in four if run is not None]
        voltage = np.column_stack([run.voltage_mv for run in runs])
        driven, _ = simulate_motor(motor, voltage[1:], runs[0].period_s)
        width = max(round(SWAP_S / runs[0].period_s), 1)
        shown = np.column_stack([_bridged(run.rev_s) for run in runs])
        seen, driven = (one[width:] - one[:-width] for one in (shown, driven))
        products += seen.T @ driven
        squares += [(seen**2).sum(axis=0), (driven**2).sum(axis=0)]
    if not squares.all():
        return
    correlation = products / np.sqrt(np.outer(*squares))
    rotors, goes_with = linear_sum_assignment(-correlation)
    moved = np.flatnonzero(goes_with != rotors)
    if len(moved) and np.all(
        correlation[moved, goes_with[moved]] > correlation[moved, moved] + SWAP_MARGIN
    ):
        pairs = ", ".join(f"rotor {i + 1} with motor {goes_with[i] + 1}'s" for i in moved)
        raise BadInputError(
            f"the recorded rotor speeds are not in the order of the motors: they go {pairs} PWM;"
            " correct the order of the sensors or of the columns"
        )


def _bridged(values: Array) -> Array:
    rows = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), rows, values[rows])


def _rotors(fit: RotorFit) -> list[dict[str, Any]]:
    """For the model file: each rotor's constants and what stands behind them."""
    return [
        {
            "rotor": rotor + 1,
            "sensor": bool(fit.told[rotor]),
            **msgspec.structs.asdict(motor),
            "holding_mv": float(np.exp(shape[0])),
            "holding_stderr_mv": float(np.exp(shape[0]) * error[0]),
            "time_constant_s": float(np.exp(shape[1])),
            "time_constant_stderr_s": float(np.exp(shape[1]) * error[1]),
            "quadratic_share": float(shape[2]),
            "quadratic_share_stderr": float(error[2]),
        }
        for rotor, (motor, shape, error) in enumerate(
            zip(fit.motors, fit.shape, fit.stderr, strict=True)
        )
    ]


def _findings(fit: RotorFit) -> list[str]:
    """In words: how the rotors differ, and how steady each is."""
    speed, holding = fit.speed_rev_s, np.exp(fit.shape[:, 0])
    slow, errors = 1e3 * np.exp(fit.shape[:, 1]), fit.stderr
    low, high = float(holding.min()), float(holding.max())
    lines = [
        f"at {speed:.0f} rev/s M1..M4 take {', '.join(f'{mv:.0f}' for mv in holding)} mV"
        f" (+- {float((holding * errors[:, 0]).mean()):.0f}): they differ by"
        f" {100 * (high / low - 1):.1f} %"
    ]
    if fit.spread[1] == 0.0:
        lines.append(
            f"time constant {slow[0]:.1f} ms +- {slow[0] * errors[0, 1]:.1f} for all: the data"
            " tell no difference between the rotors"
        )
    else:
        lines.append(
            f"time constants {', '.join(f'{ms:.1f}' for ms in slow)} ms"
            f" (+- {float((slow * errors[:, 1]).mean()):.1f})"
        )
    lines.append(
        f"what holds a speed changes by {100 * fit.drift:.1f} % from flight to flight"
        if fit.flights > 1
        else f"what holds a speed changes by {100 * fit.drift:.1f} % during the flight"
    )
    unknown = np.flatnonzero(~fit.told)
    return [*lines, *(f"M{rotor + 1} is taken as the mean of the others" for rotor in unknown)]


def _warnings(fit: RotorFit) -> list[str]:
    if fit.s_from_data:
        return []
    share, error = float(fit.shape[:, 2].mean()), float(fit.stderr[:, 2].mean())
    return [
        "a2 is hardly identified, because the thrust hardly changes: the share of the load that is"
        f" quadratic is {share:.2f} +- {error:.2f}, the given motor's included as a guess"
    ]
