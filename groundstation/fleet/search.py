"""Every craft of a catalogue searched once for the effects that its model is missing."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from groundstation.dynamics.model import Model
from groundstation.fleet.craft_search import COLUMNS, KEY, CraftFlights, row_of, searching
from groundstation.fleet.findings import findings_of
from groundstation.fleet.fit import LEAST_AIR_S, fits_table
from groundstation.fleet.gather import MADE_BY, gathered, set_aside
from groundstation.fleet.index import lasting, recordings_of, usable
from groundstation.fleet.parts import Parts, Row
from groundstation.identification.fit_record import Progress, silent

FLIGHTS = 6
"""Of each craft, unless asked otherwise: a search takes its memory and time by rows."""
HELD_OUT_EVERY = 3
AXES = ("c0", "c1", "c2")
NOTHING, LEAST = 1.0, 1e-6
"""Relative standard errors: of a constant that is known to its own size, and of one known for good.
"""


@dataclass(frozen=True, slots=True)
class Searched:
    """Counts of one run, in crafts. refused: searches that told nothing; few: crafts with fewer
    than two flights that are long enough."""

    searched: int
    refused: int
    unchanged: int
    few: int


def effects_table(catalogue: Path) -> Parts:
    return Parts(catalogue / "effects", COLUMNS, KEY)


def search_all(
    catalogue: Path,
    *,
    model: Model | None,
    vehicle: str | None,
    flights: int = FLIGHTS,
    workers: int,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> Searched:
    """Search what no earlier run has searched with the same flights and settings.

    model: what every craft is held against; None: its own fit. flights: of each craft at most.

    Raises BadInputError where there is no catalogue.
    """
    recordings = recordings_of(catalogue)
    fits = fits_table(catalogue).rows()
    counted = usable(recordings)
    begins = last_changes(counted, fits)
    by_craft: dict[str, list[Row]] = {}
    for row in lasting(counted, LEAST_AIR_S):
        by_craft.setdefault(row["craft"], []).append(row)
    of = "own fit" if model is None else model_digest(model)
    described = f"{MADE_BY}, {of}, {vehicle or 'vehicle as recorded'}"
    tasks = [
        task
        for craft, rows in sorted(by_craft.items())
        if (task := chosen(craft, rows, fits, begins.get(craft, ""), flights, described))
        is not None
    ]
    table = effects_table(catalogue)
    known = table.rows()
    fresh = [
        task
        for task in tasks
        if task.craft not in known or known[task.craft]["settings"] != task.settings
    ]
    rows_found = gathered(
        table,
        searching(model, vehicle),
        fresh,
        lambda task: set_aside(row_of(task), "searches"),
        at_once=1,
        doing="searching craft",
        workers=workers,
        scheduler=scheduler,
        progress=progress,
    )
    refused = sum(row["reason"] is not None for row in rows_found)
    table.compact([task.craft for task in tasks])
    return Searched(len(fresh), refused, len(tasks) - len(fresh), len(by_craft) - len(tasks))


def model_digest(model: Model) -> str:
    """What tells one model from another, in a row's settings."""
    import msgspec

    return "model " + hashlib.sha256(msgspec.json.encode(model)).hexdigest()[:16]


def last_changes(recordings: Sequence[Row], fits: Mapping[str, Row]) -> dict[str, str]:
    """Craft -> date since which it is what it is now, of crafts that changed: flights from before
    are of another craft."""
    found: dict[str, str] = {}
    for one in findings_of(recordings, dict(fits)).findings:
        if one.kind == "change":
            found[one.craft] = max(one.since, found.get(one.craft, ""))
    return found


def chosen(
    craft: str,
    rows: Sequence[Row],
    fits: Mapping[str, Row],
    begun: str,
    most: int,
    described: str,
) -> CraftFlights | None:
    """The flights whose fits tell c0, c1 and c2 best (mean log relative error), or the longest
    where not all are fitted, none older than ``begun``; every third of them, by date, is held out.
    None for a craft with fewer than two."""
    young = [row for row in rows if row["begun"] >= begun]
    fitted = all(row["address"] in fits for row in young)

    def rank(row: Row) -> tuple[float, float, str]:
        told = _log_errors(fits[row["address"]]) if fitted else 0.0
        return told, -row["airborne_s"], row["address"]

    best = sorted(young, key=rank)[: max(2, most)]
    if len(best) < 2:
        return None
    best.sort(key=lambda row: (row["begun"], row["address"]))
    held = {one["address"] for one in best[HELD_OUT_EVERY - 1 :: HELD_OUT_EVERY]}
    held = held or {best[-1]["address"]}
    told = hashlib.sha256(" ".join(one["sha256"] for one in best).encode()).hexdigest()[:16]
    return CraftFlights(
        craft,
        tuple(one["address"] for one in best if one["address"] not in held),
        tuple(one["address"] for one in best if one["address"] in held),
        f"{described}, flights {told}",
    )


def _log_errors(fit: Row) -> float:
    """Sum of the logarithms of a fit's relative standard errors of ``AXES``."""
    values = ((fit[name], fit[f"{name}_stderr"]) for name in AXES)
    return sum(
        math.log(
            NOTHING
            if value is None or stderr is None
            else min(NOTHING, max(stderr / abs(value), LEAST))
        )
        for value, stderr in values
    )
