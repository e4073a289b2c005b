"""Every flight of a catalogue fitted once; what was fitted already is not fitted again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from groundstation.fleet.flight_fit import COLUMNS, KEY, fitting, row_of, settings_of
from groundstation.fleet.gather import gathered, set_aside
from groundstation.fleet.index import SETTLED, changed_since, lasting, recordings_of, usable
from groundstation.fleet.parts import Parts
from groundstation.identification.fit_record import Progress, silent

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
        fitting(vehicle, effects),
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
