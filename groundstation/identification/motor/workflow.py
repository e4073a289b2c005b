"""From recordings to a model with its motor: preparation, supply, fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import EffectTerm, Estimate, Model, with_motor
from groundstation.dynamics.simulation import armature_mv, each_motor, simulate_motor
from groundstation.dynamics.vehicle import Configuration, MotorConstants, Motors, Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.estimate import (
    Evidence,
    Figures,
    Identified,
    Progress,
    effect_terms,
    fitted_effects,
    inverse,
    liveliest,
    rms,
    sandwich,
    silent,
    with_effects,
)
from groundstation.identification.flight import LAST, Stretch, hold_out, turning
from groundstation.identification.motor.fit import (
    EFFECTS,
    MotorFit,
    MotorRun,
    bench_run,
    delay_in_words,
    fit_motor,
    motor_pictures,
    simulate_run,
    speed_from_gate,
    validate_motor,
)
from groundstation.identification.runs import (
    EVERYTHING,
    Run,
    Selection,
    bridged,
    require_known,
    runs_of,
    selected,
)
from groundstation.prediction.drive import held, reading_rhythm
from groundstation.report.page import against, lines, points
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.samples import SampleBatch

if TYPE_CHECKING:
    pass

# What a recording is before anything is fitted to it (thesis 7.2.2, 7.3.4), as figures.


BENCH_S, FLOWN_S = 8.0, 4.0
TORQUE = "u', (rev/s)^2"


def bench_figures(run: Run, motor: int) -> Figures:
    """Of a run of the bench: half periods with the glitches that were left out, rotor speed,
    armature voltage. motor: which one carries the gate, from 0."""
    volts = armature_mv(run.duty, run.supply_v)[:, motor] / 1e3
    rows = liveliest(volts, run.period_s, BENCH_S)
    run, volts, name = run[rows], volts[rows], f"M{motor + 1}"
    gate = speed_from_gate(run)
    kept, half = np.isfinite(gate.rev_s), 1e3 * run.debug_s
    periods = {
        "kept": np.where(kept, half, np.nan),
        "left out": np.where(gate.rejected, half, np.nan),
    }
    return [
        (
            points(run.time_s, periods, "half period, ms"),
            f"Half a revolution as the gate times it: {100 * gate.glitches:.1f} % of the fresh"
            " readings are left out as missed or doubled passages; those that repeat the one"
            " before are no readings, and not shown.",
        ),
        (lines(run.time_s[kept], {name: gate.rev_s[kept]}, "rev/s"), "Rotor speed."),
        (
            lines(run.time_s, {name: volts, "battery": run.supply_v}, "V"),
            "Armature voltage: duty times the reported battery voltage.",
        ),
    ]


def flight_figures(stretch: Stretch, configuration: Configuration) -> Figures:
    """Of a stretch of flight: armature voltages, rotor speeds, and each angle with the torque that
    turns it, where each moves most."""

    def shown(values: Array) -> slice:
        rows = liveliest(values[stretch.rows], run.period_s, FLOWN_S)
        return slice(stretch.first + rows.start, stretch.first + rows.stop)

    def by_motor(values: Array) -> dict[str, Array]:
        return {f"M{i + 1}": values[rows, i] for i in range(4)}

    run, squares = stretch.run, stretch.squares
    torque, speeds = squares.mixed(configuration), np.sqrt(squares.end)
    volts = armature_mv(run.duty, run.supply_v) / 1e3
    time = run.time_s - run.recording_start_s
    rows = shown(np.asarray(speeds.max(axis=1) - speeds.min(axis=1)))
    found = [
        (lines(time[rows], by_motor(volts), "V"), "Armature voltages."),
        (lines(time[rows], by_motor(speeds), "rev/s"), "Speeds of the rotors."),
    ]
    for axis, name in enumerate(AXES):
        rows = shown(torque[:, axis])
        angle = np.degrees(run.attitude[rows, axis])
        if np.isfinite(angle).all():
            made = against(time[rows], angle, f"{name}, deg", torque[rows, axis], TORQUE)
            found.append((made, f"{name.capitalize()} and, dashed, its torque."))
    return found


LONG_S, MOST = 2.5, 0.8
"""Stretches from which a motor fit gains, and the share of a recording that they hold at least."""


def motor_runs(recordings: Sequence[tuple[SampleBatch, str]]) -> list[Run]:
    """Runs of the motor bench as they are. Flights with recorded rotor speeds uncut where long
    stretches hold most of them, else bridged: what a motor was given in a lost row may be far from
    a straight line. recordings: the samples of each, and its name.

    Raises BadInputError where a recording has no run, or no rate of inertial telemetry.
    """
    if not any(np.isfinite(samples.rotor_rev_s).any() for samples, _ in recordings):
        return [run for samples, name in recordings for run in runs_of(samples, name)]
    return [run for samples, name in recordings for run in _flown(samples, name)]


def _flown(samples: SampleBatch, name: str) -> list[Run]:
    try:
        long = runs_of(samples, name, LONG_S)
    except BadInputError:
        long = []
    whole = sum(map(len, long)) >= MOST * len(samples)
    return long if whole else bridged(samples, name, least_s=1.0)


# The voltage that drives the motors, where the reported one lags and sags.
#
# A craft reports its battery through a slow filter, measured before the wires to the motors. The
# cell's own sag is in the report, late; what the wires lose is not in it at all. With the motors'
# currents modelled, both can be undone:
#
#     reported = lag of (E(t) - A sum d u + B sum d n)
#
# is linear in E (a polynomial in time and the charge drawn so far), A (cell over winding
# resistance) and B (the same, over the bound of the back-EMF constant); d is duty, u = d V armature
# voltage, n speed in volts of that bound. The lag is searched.


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
    lag = share = 0.0
    for _ in range(3):
        armature = run.duty * motors[:, None]
        speed, _square = simulate_motor(motor, 1000.0 * armature[1:], run.period_s)
        back = (run.duty * speed) @ emf_v
        regression = _Regression(run, (run.duty * armature).sum(axis=1), back, read)
        lag = regression.best_lag() if LAG in effects else 0.0
        terminal, share = regression.terminal(lag)
        # V = terminal - wires (sum d^2 V - k sum d n) / winding, linear in V.
        squares = (run.duty**2).sum(axis=1)
        motors = (terminal + wires / winding * back) / (1.0 + wires / winding * squares)
    error = regression.lag_stderr(lag) if LAG in effects else 0.0
    return SupplyEstimate(motors, lag, error, share * winding, rms(regression.error(lag)))


def undo_supply(
    runs: Sequence[Run], motor: MotorConstants | Motors, vehicle: Vehicle, effects: Sequence[str]
) -> tuple[list[Run], list[SupplyEstimate]]:
    """Runs whose ``supply_v`` is what the motors really get, and the estimates behind it. Raises
    BadInputError where PWM or battery voltage are missing."""
    found, estimates = [], []
    for run in runs:
        require_known(run, ("duty", "supply_v"), "a supply cannot be modelled without it")
        estimate = estimate_supply(run, motor, vehicle, effects)
        found.append(replace(run, supply_v=estimate.motors_v))
        estimates.append(estimate)
    return found, estimates


def fit_motor_and_supply(
    runs: Sequence[Run], vehicle: Vehicle, motor: int = 0, effects: Sequence[str] = (LAG, SAG)
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


class _Regression:
    """The report as a lagged sum of columns: E's polynomial, -load, back-EMF."""

    def __init__(self, run: Run, load: Array, back: Array, read: NDArray[np.int64]) -> None:
        self.run, self.read, time = run, read, np.linspace(-1.0, 1.0, len(run))
        drawn = [np.cumsum(one - one.mean()) / len(run) for one in (load, back)]
        self.plain = np.column_stack([np.ones(len(run)), time, time**2, -load, back, *drawn])

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
    if unknown := sorted(set(effects) - set(KNOWN)):
        raise BadInputError(f"--with {', '.join(unknown)}: the motor fit knows {', '.join(KNOWN)}")
    pointless = [name for name in effects if name in (LAG, SAG)]
    if pointless and measured:
        raise BadInputError(
            f"--with {', '.join(pointless)}: needs bench recordings, on which all motors are"
            " driven alike"
        )
    if measured:
        from groundstation.identification.motor.rotors import identify_rotors

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
    found = fit.motor, fit.estimates["delay_s"], fit.estimates.of_effects
    drawn = [(run, simulate_run(run, *found)) for run in driven[:4]]
    traces, residuals = motor_pictures(drawn, sum(len(run) for run in fit_on))
    terms = [*effect_terms(fit.estimates), *supply_terms(supplied, supplies, vehicle)]
    account = {
        "what": "motor",
        "method": "prediction error" + (", supply modelled" if supplied else ""),
        "samples": sum(len(run) for run in fit_on),
        "selection": str(selection),
        "held_out": apart,
        "estimates": fit.estimates.as_dict(),
        "rejected_readings": fit.rejected,
        "identification": {
            "rotor_rms_rev_s": list(fit.rms_rev_s),
            "rotor_fit_percent": list(fit.fit_percent),
        },
        "validation": [
            {"recording": run.name, "rotor_fit_percent": percent, "rotor_rms_rev_s": error}
            for run in driven
            for percent, error in [validate_motor(run, *found)]
        ],
        "residual_tests": {one.channel: one.as_dict() for one in residuals},
        "supply": [one.as_dict() for one in supplies],
        "findings": [delay_in_words(fit.estimates)],
        "warnings": [*fit.warnings, *([SUPPLY_DOUBT] if supplied else [])],
    }
    model = msgspec.structs.replace(
        with_motor(before, fit.motor), effects=with_effects(before, terms)
    )
    prepared = partial(bench_figures, max(fit_on, key=len), motor)
    evidence = Evidence({"motor": fit.estimates}, traces, residuals, (), prepared)
    return Identified(model, account, evidence)


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
        for part in run.parts(turning(run), PIECE_S)
    ]
    if selection != EVERYTHING:
        parts = [one for part in parts for one in part.parts(selected(part, selection), PIECE_S)]
    if not parts:
        names = ", ".join(sorted({run.name for run in runs}))
        wanted = "" if selection == EVERYTHING else f" while {selection}"
        raise BadInputError(
            f"{names}: the motors never turn for {PIECE_S:.0f} s{wanted}; record with motors"
            " running"
        )
    return parts
