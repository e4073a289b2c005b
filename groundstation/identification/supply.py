"""The voltage that drives the motors, where the reported one lags and sags.

A craft reports its battery through a slow filter, measured before the wires to the motors. The
cell's own sag is in the report, late; what the wires lose is not in it at all. With the motors'
currents modelled, both can be undone:

    reported = lag of (E(t) - A sum d u + B sum d n)

is linear in E's polynomial, A (cell and wires over winding resistance) and B (the same times the
back-EMF constant); d is duty, u = d V armature voltage, n speed. The lag is searched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.motor import simulate_motor
from groundstation.dynamics.vehicle import MotorConstants, Vehicle
from groundstation.identification.motor import MotorFit, bench_run, fit_motor
from groundstation.identification.runs import Run

Array = NDArray[np.float64]

LAGS_S = np.concatenate([[0.0], np.geomspace(0.02, 0.5, 24)])
ROUNDS = 6


@dataclass(frozen=True, slots=True)
class SupplyEstimate:
    """What one run tells about its supply.

    motors_v, terminal_v: (n,) at the motors and where the report is measured. lag_s: of the
    report. cell_ohm: resistance behind the terminals. rms_v: of the report against the model.
    """

    motors_v: Array
    terminal_v: Array
    lag_s: float
    cell_ohm: float
    rms_v: float


def estimate_supply(run: Run, motor: MotorConstants, vehicle: Vehicle) -> SupplyEstimate:
    """Undo the report's lag and the wires' loss for one run, with modelled rotor speeds.

    The wires' and windings' resistances are the profile's; currents follow from the motor
    model, back-EMF by its bound a1/a0.
    """
    terminal = run.supply_v.copy()
    motors = terminal
    winding, wires = vehicle.winding_ohm, vehicle.battery.supply_ohm
    emf_v = motor.a1 / motor.a0 / 1000.0
    lag, cell, error = 0.0, 0.0, np.inf
    for _ in range(3):
        armature = run.duty * motors[:, None]
        speed, _square = simulate_motor(motor, 1000.0 * armature[1:], run.period_s)
        load = (run.duty * armature).sum(axis=1)
        back = (run.duty * speed).sum(axis=1)
        fits = [(*_regress(run, load, back, tau), tau) for tau in LAGS_S]
        error, terminal, share, lag = min(fits, key=lambda fit: fit[0])
        cell = share * winding
        # V = terminal - wires (sum d^2 V - k sum d n) / winding, linear in V.
        squares = (run.duty**2).sum(axis=1)
        motors = (terminal + wires / winding * emf_v * back) / (1.0 + wires / winding * squares)
    return SupplyEstimate(motors, terminal, float(lag), float(cell), float(error))


def fit_motor_and_supply(
    runs: Sequence[Run], vehicle: Vehicle, motor: int = 0
) -> tuple[MotorFit, list[SupplyEstimate]]:
    """Motor parameters from bench recordings whose battery reading lags and sags.

    Alternates between the motor fit and the supply that its currents explain until both agree;
    starts from the reading as it is.
    """
    plain = [bench_run(run, motor) for run in runs]
    fit = fit_motor(plain)
    supplies: list[SupplyEstimate] = []
    for _ in range(ROUNDS):
        supplies = [estimate_supply(run, fit.motor, vehicle) for run in runs]
        driven = [
            replace(one, voltage_mv=1000.0 * run.duty[:, motor] * supply.motors_v)
            for one, run, supply in zip(plain, runs, supplies, strict=True)
        ]
        before, fit = fit, fit_motor(driven)
        if abs(fit.motor.a0 / before.motor.a0 - 1) < 1e-5:
            break
    return fit, supplies


def _regress(run: Run, load: Array, back: Array, lag_s: float) -> tuple[float, Array, float]:
    """RMS error of the report, the terminal voltage without lag, and A."""
    time = np.linspace(-1.0, 1.0, len(run))
    plain = np.column_stack([np.ones(len(run)), time, time**2, -load, back])
    lagged = _low_pass(plain, lag_s, run.period_s)
    start = min(len(run) // 4, round(3 * lag_s / run.period_s))
    weights, *_ = np.linalg.lstsq(lagged[start:], run.supply_v[start:], rcond=None)
    error = run.supply_v[start:] - lagged[start:] @ weights
    return float(np.sqrt(np.mean(error**2))), plain @ weights, float(weights[3])


def _low_pass(signals: Array, lag_s: float, period_s: float) -> Array:
    """First-order lag, settled at the first row."""
    if lag_s == 0.0:
        return signals
    from scipy.signal import lfilter

    keep = float(np.exp(-period_s / lag_s))
    start = keep * signals[:1]
    filtered, _ = lfilter([1.0 - keep], [1.0, -keep], signals, axis=0, zi=start)
    return np.asarray(filtered)
