"""Every flight of a catalogue fitted once: what it says of its craft, with standard errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from groundstation.fleet.engine import MADE_BY, Parts, Row, gathered, set_aside, with_reason
from groundstation.fleet.index import (
    SETTLED,
    changed_since,
    fetched,
    lasting,
    recordings_of,
    usable,
)
from groundstation.identification.estimate import Progress, silent
from groundstation.paths import digest
from groundstation.telemetry.arrays import Array

if TYPE_CHECKING:
    from groundstation.identification.flight import Stretch

# What one flight says of its craft, each value with a standard error: what a fleet compares.
#
# Motors keep the profile's constants: a weaker one shows in what the others must make up for.


CONSTANTS = ("c0", "c1", "c2", "thrust_per_mass")
ROTORS = ("rotor_1", "rotor_2", "rotor_3", "rotor_4")
QUANTITIES = (*CONSTANTS, *ROTORS, "cell_ohm", "shake_dps")
"""c0..c2, thrust_per_mass: of ``fit body``. rotor_1..4: by how much more the rotor is driven than
the mean of the four (squared speed, share of the mean) - a weaker one more, those opposite a
shifted centre of gravity less. cell_ohm: behind the battery's terminals. shake_dps: what of the
roll and pitch rates changes from row to row, their noise included."""
WORDS = {
    "c0": "turning about roll",
    "c1": "turning about pitch",
    "c2": "turning about yaw",
    "thrust_per_mass": "thrust per mass",
    **{name: f"what rotor {name[-1]} is asked for" for name in ROTORS},
    "cell_ohm": "the battery's resistance",
    "shake_dps": "the gyro's vibration",
}
RELATIVE = frozenset((*CONSTANTS, "cell_ohm", "shake_dps"))
"""Positive constants, compared by their logarithms: a change is a share."""
BLOCK_S = 1.0

COLUMNS = {
    "address": "text",
    "sha256": "text",
    "settings": "text",
    "reason": "text",
    "seconds": "number",
    **dict.fromkeys(QUANTITIES, "number"),
    **{f"{name}_stderr": "number" for name in QUANTITIES},
}
"""Of the catalogue's table ``fits``. seconds: of flight; reason: why it told nothing."""
KEY = "address"
VALUES = ("reason", *QUANTITIES, *(f"{name}_stderr" for name in QUANTITIES))
"""Columns that findings are made of."""


def settings_of(vehicle: str | None, effects: tuple[str, ...]) -> str:
    """What a row was computed with: another needs another row."""
    return " ".join([f"{MADE_BY},", vehicle or "as recorded", *effects])


def fit_flight(address: str, vehicle: str | None, effects: tuple[str, ...]) -> Row:
    """A row of the table ``fits``. Never raises for what a file holds: that is its ``reason``.

    vehicle: a profile's name or file; None: what the recording names, or else crazyflie1."""
    row = row_of(address, settings_of(vehicle, effects))

    def told() -> Row:
        with fetched(address) as path:
            row["sha256"] = digest(path)
            values, seconds = _told(str(path), vehicle, effects)
        found: Row = {"seconds": seconds}
        for name, (value, stderr) in values.items():
            if math.isfinite(value):
                found |= {name: value, f"{name}_stderr": stderr}
        return found

    return with_reason(row, told)


def row_of(address: str, settings: str, sha256: str | None = None) -> Row:
    """A row of the table ``fits`` that tells nothing yet."""
    row: Row = dict.fromkeys(COLUMNS)
    return row | {KEY: address, "sha256": sha256, "settings": settings}


def _told(
    path: str, vehicle: str | None, effects: tuple[str, ...]
) -> tuple[dict[str, tuple[float, float]], float]:
    from groundstation.dynamics.vehicle import load_vehicle
    from groundstation.identification.body import fit_body
    from groundstation.identification.flight import stretches_of
    from groundstation.identification.motor.workflow import estimate_supply
    from groundstation.identification.runs import bridged
    from groundstation.recording.formats import open_for_analysis
    from groundstation.recording.session import vehicle_of

    recording = open_for_analysis(path)
    profile = load_vehicle(vehicle_of([recording], vehicle) or "crazyflie1")
    runs = bridged(recording.samples, recording.path.name)
    stretches = stretches_of(runs, profile.motor)
    found = _trims(stretches)
    found["shake_dps"] = (_shake_dps(stretches), 0.0)
    longest = max(runs, key=len)
    found["cell_ohm"] = (estimate_supply(longest, profile.motor, profile).cell_ohm, 0.0)
    fit = fit_body(stretches, profile, effects)
    for name, value, stderr in zip(
        fit.estimates.names, fit.estimates.values, fit.estimates.stderr, strict=True
    ):
        if name in CONSTANTS and name not in fit.not_identified:
            found[name] = (float(value), float(stderr))
    return found, sum(len(one) * one.run.period_s for one in stretches)


def _trims(stretches: list[Stretch]) -> dict[str, tuple[float, float]]:
    """Share by which each rotor's squared speed exceeds the mean, from blocks of a second."""
    blocks: list[Array] = []
    for one in stretches:
        square = one.squares.square[one.rows]
        width = round(BLOCK_S / one.run.period_s)
        count = len(square) // width
        means = square[: count * width].reshape(count, width, 4).mean(axis=1)
        blocks.extend(means / means.mean(axis=1, keepdims=True) - 1.0)
    shares = np.array(blocks)
    mean = shares.mean(axis=0)
    stderr = shares.std(axis=0, ddof=1) / math.sqrt(len(shares))
    return {name: (float(mean[i]), float(stderr[i])) for i, name in enumerate(ROTORS)}


def _shake_dps(stretches: list[Stretch]) -> float:
    """Standard deviation of white noise with the same second differences, of roll and pitch: the
    median over blocks of a second, for a landing is no vibration."""
    blocks = []
    for one in stretches:
        bend = np.diff(np.degrees(one.run.gyro[one.rows, :2]), n=2, axis=0)
        width = round(BLOCK_S / one.run.period_s)
        count = len(bend) // width
        blocks.extend((bend[: count * width].reshape(count, -1) ** 2).mean(axis=1) / 6.0)
    return math.sqrt(float(np.median(blocks)))


# Every flight of a catalogue fitted once; what was fitted already is not fitted again.


KEPT_AT = 20
"""Rows that make a file of their own."""
LEAST_AIR_S = 8.0
"""A shorter flight tells next to nothing of a body."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """Counts of one run. short: flights too short to fit; refused: fits that told nothing."""

    fitted: int
    refused: int
    unchanged: int
    short: int


def fits_table(catalogue: Path) -> Parts:
    return Parts(catalogue / "fits", COLUMNS, KEY)


def fit_all(
    catalogue: Path,
    *,
    vehicle: str | None,
    effects: tuple[str, ...],
    workers: int,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Fit what the catalogue holds and no earlier run has fitted with the same settings.

    Raises BadInputError where there is no catalogue.
    """
    rows = usable(recordings_of(catalogue, ("sha256", "state", "airborne_s")))
    table, settings = fits_table(catalogue), settings_of(vehicle, effects)
    long = {one[KEY]: one for one in lasting(rows, LEAST_AIR_S)}
    to_fit = changed_since(table.rows(SETTLED), long, settings)
    fitted = gathered(
        table,
        partial(fit_flight, vehicle=vehicle, effects=effects),
        to_fit,
        lambda address: set_aside(row_of(address, settings, long[address]["sha256"]), "fits"),
        at_once=KEPT_AT,
        doing="fitting",
        workers=workers,
        scheduler=scheduler,
        progress=progress,
    )
    refused = sum(row["reason"] is not None for row in fitted)
    table.compact(list(long))
    return Fitted(len(to_fit), refused, len(long) - len(to_fit), len(rows) - len(long))
