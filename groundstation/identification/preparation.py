"""What a recording becomes before anything is fitted to it (thesis 7.2.2, 7.3.4), as figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundstation.dynamics.simulation import armature_mv
from groundstation.dynamics.vehicle import Configuration
from groundstation.identification.fit_record import liveliest
from groundstation.identification.motor.rotor_speed import GateReading, speed_from_gate
from groundstation.identification.runs import Run
from groundstation.identification.stretches import Stretch
from groundstation.report.page import against, lines, points
from groundstation.telemetry.arrays import AXES, Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


BENCH_S, FLOWN_S = 8.0, 4.0
TORQUE = "u', (rev/s)^2"


@dataclass(frozen=True, slots=True)
class BenchPreparation:
    """A run of the motor bench. motor: which one carries the gate, from 0."""

    run: Run
    motor: int

    def figures(self) -> list[tuple[Figure, str]]:
        """Half periods with the glitches that were left out, rotor speed, armature voltage."""
        volts = self._volts()
        rows = liveliest(volts, self.run.period_s, BENCH_S)
        run, volts, name = self.run[rows], volts[rows], f"M{self.motor + 1}"
        gate = speed_from_gate(run)
        kept = np.isfinite(gate.rev_s)
        periods = _half_periods_ms(run, gate)
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

    def _volts(self) -> Array:
        return armature_mv(self.run.duty, self.run.supply_v)[:, self.motor] / 1e3


@dataclass(frozen=True, slots=True)
class FlightPreparation:
    """A stretch of flight, with the rotors behind it."""

    stretch: Stretch
    configuration: Configuration

    def figures(self) -> list[tuple[Figure, str]]:
        """Armature voltages, rotor speeds, and each angle with the torque that turns it."""
        run, squares = self.stretch.run, self.stretch.squares
        torque = squares.mixed(self.configuration)
        speeds = np.sqrt(squares.end)
        volts = armature_mv(run.duty, run.supply_v) / 1e3
        time = run.time_s - run.recording_start_s
        rows = self._liveliest(np.asarray(speeds.max(axis=1) - speeds.min(axis=1)))
        found = [
            (lines(time[rows], _by_motor(volts[rows]), "V"), "Armature voltages."),
            (lines(time[rows], _by_motor(speeds[rows]), "rev/s"), "Speeds of the rotors."),
        ]
        for axis, name in enumerate(AXES):
            rows = self._liveliest(torque[:, axis])
            angle = np.degrees(run.attitude[rows, axis])
            if np.isfinite(angle).all():
                made = against(time[rows], angle, f"{name}, deg", torque[rows, axis], TORQUE)
                found.append((made, f"{name.capitalize()} and, dashed, its torque."))
        return found

    def _liveliest(self, values: Array) -> slice:
        """The rows of the stretch in which a channel of the run (n,) moves most."""
        first = self.stretch.first
        rows = liveliest(values[self.stretch.rows], self.stretch.run.period_s, FLOWN_S)
        return slice(first + rows.start, first + rows.stop)


def _half_periods_ms(run: Run, gate: GateReading) -> dict[str, Array]:
    half, kept = 1e3 * run.debug_s, np.isfinite(gate.rev_s)
    return {
        "kept": np.where(kept, half, np.nan),
        "left out": np.where(gate.rejected, half, np.nan),
    }


def _by_motor(values: Array) -> dict[str, Array]:
    return {f"M{i + 1}": values[:, i] for i in range(4)}


def bench_preparation(runs: Sequence[Run], motor: int) -> BenchPreparation:
    """Of the longest run."""
    return BenchPreparation(max(runs, key=len), motor)


def flight_preparation(
    stretches: Sequence[Stretch], configuration: Configuration
) -> FlightPreparation:
    """Of the longest stretch."""
    return FlightPreparation(max(stretches, key=len), configuration)
