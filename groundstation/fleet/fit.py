"""Every flight of a catalogue fitted once; what was fitted already is not fitted again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from groundstation.fleet.engine import carried_out
from groundstation.fleet.flight_fit import COLUMNS, KEY, fitting, settings_of
from groundstation.fleet.index import Told, recordings_of
from groundstation.fleet.parts import Parts, Row

KEPT_AT = 20
"""Results that make a file of their own: what a run that is killed loses at most."""
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
    progress: Told = lambda _share, _what: None,
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
    fresh: list[Row] = []
    refused = 0
    for count, (address, row) in enumerate(
        carried_out(fitting(vehicle, effects), to_fit, workers=workers, scheduler=scheduler), 1
    ):
        fresh.append(row or _deadly(address, long[address], settings))
        refused += fresh[-1]["reason"] is not None
        if len(fresh) >= KEPT_AT:
            table.append(fresh)
            fresh = []
        progress(count / len(to_fit), f"fitting {count} of {len(to_fit)}")
    table.append(fresh)
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
