"""Every flight of a catalogue fitted once; what was fitted already is not fitted again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from groundstation.fleet.flight_fit import COLUMNS, KEY, fitting, settings_of
from groundstation.fleet.gather import gathered
from groundstation.fleet.index import recordings_of
from groundstation.fleet.parts import Parts, Row
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
    rows = [one for one in recordings_of(catalogue) if one["state"] not in ("damaged", "bad")]
    table = fits_table(catalogue)
    known, settings = table.rows(), settings_of(vehicle, effects)
    long = {one[KEY]: one for one in rows if (one["airborne_s"] or 0.0) >= LEAST_AIR_S}
    to_fit = [
        address
        for address, row in long.items()
        if address not in known
        or (known[address]["sha256"], known[address]["settings"]) != (row["sha256"], settings)
    ]
    fitted = gathered(
        *(table, fitting(vehicle, effects), to_fit),
        lambda address: _deadly(address, long[address], settings),
        at_once=KEPT_AT,
        doing="fitting",
        workers=workers,
        scheduler=scheduler,
        progress=progress,
    )
    refused = sum(row["reason"] is not None for row in fitted)
    table.compact(list(long))
    return Fitted(len(to_fit), refused, len(long) - len(to_fit), len(rows) - len(long))


def _deadly(address: str, recording: Row, settings: str) -> Row:
    """The row of a recording that every process dies of."""
    row: Row = dict.fromkeys(COLUMNS)
    return row | {
        KEY: address,
        "sha256": recording["sha256"],
        "settings": settings,
        "reason": "the process that fits it dies, again and again; it is set aside",
    }
