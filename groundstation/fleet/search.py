"""Every craft of a catalogue searched once for the effects that its model is missing."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from groundstation.dynamics.model import Model, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.fleet.engine import MADE_BY, Parts, Row, gathered, set_aside, with_reason
from groundstation.fleet.findings import findings_of
from groundstation.fleet.fit import LEAST_AIR_S, fits_table
from groundstation.fleet.index import fetched, lasting, recordings_of, usable
from groundstation.identification.estimate import Progress, silent

if TYPE_CHECKING:
    from groundstation.discrepancy.engine import Discrepancy
    from groundstation.identification.runs import Run

# Which effects one craft's model is missing, from several of its flights together.


COLUMNS = {
    "craft": "text",
    "settings": "text",
    "fitted": "texts",
    "held_out": "texts",
    "verdict": "text",
    "effects": "texts",
    "parameters": "texts",
    "values": "numbers",
    "stderrs": "numbers",
    "units": "texts",
    "changed": "texts",
    "gap_before": "number",
    "gap_after": "number",
    "left": "texts",
    "to_fly": "texts",
    "warnings": "texts",
    "model": "text",
    "reason": "text",
}
"""Of the catalogue's table ``effects``. fitted, held_out: addresses of whole flights. effects:
names in the order of joining; parameters, values, stderrs, units: of all of them, by place,
parameters as ``effect.parameter``. changed: constants of the given model that moved, in words.
to_fly: effects that these flights cannot show, with the manoeuvre. warnings: what was left out of
the flights, and what else the search warns of. model: the improved one, as a model file holds it.
reason: why nothing was told."""
KEY = "craft"


@dataclass(frozen=True, slots=True)
class CraftFlights:
    """A craft's flights, by address. settings: what a row says that it was computed with."""

    craft: str
    fitted: tuple[str, ...]
    held_out: tuple[str, ...]
    settings: str


def search_craft(flights: CraftFlights, model: Model | None, vehicle: str | None) -> Row:
    """A row of the table ``effects``. Never raises for what files hold: that is its ``reason``.

    model: what every craft is held against; None: each craft's own fit to the flights that are
    fitted. vehicle: as for ``fleet fit``."""

    def told() -> Row:
        with ExitStack() as files:
            fit_on, held = (
                [files.enter_context(fetched(one)) for one in addresses]
                for addresses in (flights.fitted, flights.held_out)
            )
            return _told(_searched(fit_on, held, model, vehicle))

    return with_reason(row_of(flights), told)


def row_of(flights: CraftFlights) -> Row:
    """A row of the table ``effects`` that tells nothing yet."""
    row: Row = dict.fromkeys(COLUMNS)
    return row | {
        KEY: flights.craft,
        "settings": flights.settings,
        "fitted": list(flights.fitted),
        "held_out": list(flights.held_out),
    }


def _searched(
    fit_on: Sequence[Path], held: Sequence[Path], model: Model | None, vehicle: str | None
) -> Discrepancy:
    from groundstation.discrepancy.engine import find_discrepancy
    from groundstation.identification.runs import flights_of_each
    from groundstation.recording.formats import open_for_analysis
    from groundstation.recording.session import require_craft_of, vehicle_of

    opened = [[open_for_analysis(path) for path in paths] for paths in (fit_on, held)]
    groups = [
        flights_of_each((one.samples, one.path.name) for one in recordings) for recordings in opened
    ]
    runs: list[list[list[Run]]] = [one for one, _ in groups]
    base = model
    if base is None:
        name = vehicle_of([*opened[0], *opened[1]], vehicle) or "crazyflie1"
        base = vehicle_model(load_vehicle(name))
    elif vehicle is None:
        for one in (*opened[0], *opened[1]):
            require_craft_of(one, base)
    left_out = [words for _, some in groups for words in some]
    return find_discrepancy(runs[0], base, runs[1], left_out=left_out, fit_base=model is None)


def _told(found: Discrepancy) -> Row:
    """The outcome in the table's columns."""
    import msgspec

    from groundstation.discrepancy.proof import what_is_left

    findings, proof = found.findings, found.proof
    every = [
        (f"{effect.name}.{name}", estimate)
        for effect in findings.effects
        for name, estimate in effect.parameters.items()
    ]
    return {
        "verdict": findings.verdict.value,
        "effects": [effect.name for effect in findings.effects],
        "parameters": [name for name, _ in every],
        "values": [one.value for _, one in every],
        "stderrs": [one.stderr for _, one in every],
        "units": [one.unit for _, one in every],
        "changed": [change.words for change in findings.base_changes],
        "gap_before": proof.before.gap,
        "gap_after": proof.after.beside(proof.before),
        "left": [one.words for one in what_is_left(proof.after)],
        "to_fly": sorted({f"{one.name}: {one.manoeuvre}" for one in findings.not_shown}),
        "warnings": list(findings.warnings),
        "model": msgspec.json.encode(findings.model).decode(),
    }


# Every craft of a catalogue searched once for the effects that its model is missing.


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
    of = "own fit"
    if model is not None:
        of = "model " + hashlib.sha256(msgspec.json.encode(model)).hexdigest()[:16]
    described = f"{MADE_BY}, {of}, {vehicle or 'vehicle as recorded'}"
    every = (
        chosen(craft, rows, fits, begins.get(craft, ""), flights, described)
        for craft, rows in sorted(by_craft.items())
    )
    tasks = [task for task in every if task is not None]
    table = effects_table(catalogue)
    known = {craft: row["settings"] for craft, row in table.rows().items()}
    fresh = [task for task in tasks if known.get(task.craft) != task.settings]
    rows_found = gathered(
        table,
        partial(search_craft, model=model, vehicle=vehicle),
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
    total = 0.0
    for name in AXES:
        value, stderr = fit[name], fit[f"{name}_stderr"]
        known = value is not None and stderr is not None
        total += math.log(min(NOTHING, max(stderr / abs(value), LEAST)) if known else NOTHING)
    return total
