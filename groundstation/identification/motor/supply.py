"""The voltage that drives the motors, where the reported one lags and sags.

A craft reports its battery through a slow filter, measured before the wires to the motors. The
cell's own sag is in the report, late; what the wires lose is not in it at all. With the motors'
currents modelled, both can be undone:

    reported = lag of (E(t) - A sum d u + B sum d n)

is linear in E (a polynomial in time and the charge drawn so far), A (cell over winding
resistance) and B (the same, over the bound of the back-EMF constant); d is duty, u = d V armature
voltage, n speed in volts of that bound. The lag is searched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import EffectTerm, Estimate
from groundstation.dynamics.simulation import each_motor, simulate_motor
from groundstation.dynamics.vehicle import MotorConstants, Motors, Vehicle
from groundstation.identification.estimate import inverse, rms, sandwich
from groundstation.identification.motor.fit import MotorFit, bench_run, fit_motor
from groundstation.identification.runs import Run, require_known
from groundstation.prediction.drive import held, reading_rhythm
from groundstation.telemetry.arrays import Array

LAGS_S = np.concatenate([[0.0], np.geomspace(0.02, 0.5, 24)])
FINER = 3
"""Times the search for the lag is repeated on a grid between the neighbours of the best."""
ROUNDS = 6
SAG, LAG = "supply_sag", "battery_reading_lag"
BLOCK_S = 0.5


@dataclass(frozen=True, slots=True)
class SupplyEstimate:
    """What one run tells about its supply.

    motors_v: (n,) at the motors. lag_s: of the report, with its standard error. cell_ohm:
    resistance behind the terminals. rms_v: of the report against the model.
    """

    motors_v: Array
    lag_s: float
    lag_stderr_s: float
    cell_ohm: float
    rms_v: float

    def as_dict(self) -> dict[str, float]:
        return {"lag_s": self.lag_s, "cell_ohm": self.cell_ohm, "report_rms_v": self.rms_v}


def estimate_supply(
    run: Run, motor: MotorConstants | Motors, vehicle: Vehicle, effects: Sequence[str] = (LAG, SAG)
) -> SupplyEstimate:
    """Undo the report's lag and the wires' loss for one run, with modelled rotor speeds.

    The wires' and windings' resistances are the profile's; currents follow from the motor
    model, back-EMF by its bound a1/a0. effects: which of the two are there.
    """
    motors = run.supply_v.copy()
    winding = vehicle.winding_ohm
    wires = vehicle.battery.supply_ohm if SAG in effects else 0.0
    emf_v = np.array([one.a1 / one.a0 / 1000.0 for one in each_motor(motor)])
    read = reading_rhythm(run.supply_v).rows(len(run))
    regression = _Regression(run, np.zeros((len(run), 7)), read)
    lag = share = 0.0
    for _ in range(3):
        armature = run.duty * motors[:, None]
        speed, _square = simulate_motor(motor, 1000.0 * armature[1:], run.period_s)
        back = (run.duty * speed) @ emf_v
        regression = _Regression.of(run, (run.duty * armature).sum(axis=1), back, read)
        lag = regression.best_lag() if LAG in effects else 0.0
        terminal, share = regression.terminal(lag)
        # V = terminal - wires (sum d^2 V - k sum d n) / winding, linear in V.
        squares = (run.duty**2).sum(axis=1)
        motors = (terminal + wires / winding * back) / (1.0 + wires / winding * squares)
    return SupplyEstimate(
        motors,
        lag,
        regression.lag_stderr(lag) if LAG in effects else 0.0,
        share * winding,
        rms(regression.error(lag)),
    )


def undo_supply(
    runs: Sequence[Run], motor: MotorConstants | Motors, vehicle: Vehicle, effects: Sequence[str]
) -> tuple[list[Run], list[SupplyEstimate]]:
    """Runs whose ``supply_v`` is what the motors really get, and the estimates behind it.

    Raises BadInputError where PWM or battery voltage are missing.
    """
    found, estimates = [], []
    for run in runs:
        require_known(run, ("duty", "supply_v"), "a supply cannot be modelled without it")
        estimate = estimate_supply(run, motor, vehicle, effects)
        found.append(replace(run, supply_v=estimate.motors_v))
        estimates.append(estimate)
    return found, estimates


def fit_motor_and_supply(
    runs: Sequence[Run],
    vehicle: Vehicle,
    motor: int = 0,
    effects: Sequence[str] = (LAG, SAG),
) -> tuple[MotorFit, list[SupplyEstimate]]:
    """Motor parameters from bench recordings whose battery reading lags and sags.

    Alternates between the motor fit and the supply that its currents explain until both agree;
    starts from the reading as it is. effects: those of the supply, and of ``fit_motor``.
    """
    plain = [bench_run(run, motor) for run in runs]
    others = [name for name in effects if name not in (SAG, LAG)]
    fit = fit_motor(plain, others)
    supplies: list[SupplyEstimate] = []
    for _ in range(ROUNDS):
        supplies = [estimate_supply(run, fit.motor, vehicle, effects) for run in runs]
        driven = [
            replace(one, voltage_mv=1000.0 * run.duty[:, motor] * supply.motors_v)
            for one, run, supply in zip(plain, runs, supplies, strict=True)
        ]
        before, fit = fit, fit_motor(driven, others)
        if abs(fit.motor.a0 / before.motor.a0 - 1) < 1e-5:
            break
    return fit, supplies


def supply_terms(
    effects: Sequence[str], supplies: Sequence[SupplyEstimate], vehicle: Vehicle
) -> list[EffectTerm]:
    """The supply's effects as models hold them: the lag that was found, the profile's wires."""
    terms = []
    if LAG in effects:
        lags = np.array([one.lag_s for one in supplies])
        errors = np.array([max(one.lag_stderr_s, 1e-6) for one in supplies])
        weights = errors**-2 / np.sum(errors**-2)
        mean = float(weights @ lags)
        spread = float(np.sqrt(weights @ (lags - mean) ** 2 / max(len(lags) - 1, 1)))
        error = max(float(np.sum(errors**-2) ** -0.5), spread)
        terms.append(EffectTerm(LAG, {"time_constant_s": Estimate(mean, error, "s")}))
    if SAG in effects:
        wires = Estimate(vehicle.battery.supply_ohm, None, "ohm")
        terms.append(EffectTerm(SAG, {"resistance_ohm": wires}))
    return terms


@dataclass(frozen=True, slots=True)
class _Regression:
    """The report as a lagged sum of columns: E's polynomial, -load, back-EMF."""

    run: Run
    plain: Array
    read: NDArray[np.int64]

    @classmethod
    def of(cls, run: Run, load: Array, back: Array, read: NDArray[np.int64]) -> _Regression:
        time = np.linspace(-1.0, 1.0, len(run))
        drawn = [np.cumsum(one - one.mean()) / len(run) for one in (load, back)]
        plain = np.column_stack([np.ones(len(run)), time, time**2, -load, back, *drawn])
        return cls(run, plain, read)

    def best_lag(self) -> float:
        """The lag in s with the smallest error of the report."""
        grid = LAGS_S
        for _ in range(FINER):
            costs = [rms(self.error(float(lag))) for lag in grid]
            best = int(np.argmin(costs))
            low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
            grid = np.linspace(low, high, 9)
        return float(grid[len(grid) // 2])

    def error(self, lag_s: float) -> Array:
        """Report less model, the first moments left out."""
        lagged, weights, start = self._solved(lag_s)
        return self.run.supply_v[start:] - lagged[start:] @ weights

    def terminal(self, lag_s: float) -> tuple[Array, float]:
        """The terminal voltage without lag, and A."""
        _, weights, _ = self._solved(lag_s)
        return np.asarray(self.plain @ weights), float(weights[3])

    def lag_stderr(self, lag_s: float) -> float:
        """Standard error of the lag, errors correlated over half a second allowed for."""
        step = 0.05 * lag_s + 1e-4
        before, after = self.error(max(lag_s - step, 0.0)), self.error(lag_s + step)
        rows = min(len(before), len(after))
        slope = (after[-rows:] - before[-rows:]) / (lag_s + step - max(lag_s - step, 0.0))
        error = self.error(lag_s)[-rows:]
        blocks = np.arange(0, rows, max(round(BLOCK_S / self.run.period_s), 1))
        scores = np.add.reduceat(slope * error, blocks)
        return float(np.sqrt(sandwich(np.array([[slope @ slope]]), scores[:, None])[0, 0]))

    def _solved(self, lag_s: float) -> tuple[Array, Array, int]:
        lagged = _low_pass(self.plain, lag_s, self.run.period_s, self.read)
        start = min(len(self.run) // 4, round(3 * lag_s / self.run.period_s))
        used = lagged[start:]
        weights = inverse(used.T @ used) @ (used.T @ self.run.supply_v[start:])
        return lagged, weights, start


def _low_pass(signals: Array, lag_s: float, period_s: float, read: NDArray[np.int64]) -> Array:
    """First-order lag of what is read in some rows and held in between, settled at the first."""
    if lag_s == 0.0:
        return signals
    from scipy.signal import lfilter

    keep = float(np.exp(-period_s * (read[1] - read[0]) / lag_s))
    start = keep * signals[read[:1]]
    filtered, _ = lfilter([1.0 - keep], [1.0, -keep], signals[read], axis=0, zi=start)
    return held(np.asarray(filtered), read, len(signals))
