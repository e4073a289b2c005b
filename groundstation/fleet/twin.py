"""A model flown beside every flight of a catalogue: which flights it no longer describes, where."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from groundstation.dynamics.model import Model, require_body
from groundstation.fleet.facts import fetched
from groundstation.fleet.gather import MADE_BY, gathered, set_aside, with_reason
from groundstation.fleet.index import SETTLED, changed_since, lasting, recordings_of, usable
from groundstation.fleet.parts import Parts, Row
from groundstation.fleet.search import model_digest
from groundstation.identification.fit_record import Progress, silent
from groundstation.paths import digest

COLUMNS = {
    "address": "text",
    "sha256": "text",
    "settings": "text",
    "told": "texts",
    "first_s": "number",
    "reason": "text",
}
"""Of the catalogue's table ``twin``. told: each disagreement in words; first_s: when the first was
noticed, device time; reason: why the model could not fly beside it."""
KEY = "address"
KEPT_AT = 20
"""Rows that make a file of their own."""
LEAST_AIR_S = 10.0
"""The twin learns the noise of a flight first."""


@dataclass(frozen=True, slots=True)
class Watched:
    """Counts of one run, in flights. disagreeing: of all that are in the table."""

    watched: int
    refused: int
    unchanged: int
    short: int
    disagreeing: int


def twin_table(catalogue: Path) -> Parts:
    return Parts(catalogue / "twin", COLUMNS, KEY)


def watch_all(
    catalogue: Path,
    model: Model,
    *,
    asked: bool = False,
    workers: int,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> Watched:
    """Fly the model beside what no earlier run has with the same model.

    asked: whatever recordings say, they are of the model's vehicle.

    Raises BadInputError where there is no catalogue, or the model has no body.
    """
    require_body(model)
    rows = usable(recordings_of(catalogue, ("sha256", "state", "airborne_s")))
    table, settings = twin_table(catalogue), f"{MADE_BY}, {model_digest(model)}"
    long = {one[KEY]: one for one in lasting(rows, LEAST_AIR_S)}
    fresh = changed_since(table.rows(SETTLED), long, settings)
    found = gathered(
        *(table, partial(watch_flight, model=model, settings=settings, asked=asked), fresh),
        lambda address: set_aside(_row(address, long[address]["sha256"], settings), "watches"),
        at_once=KEPT_AT,
        doing="watching",
        workers=workers,
        scheduler=scheduler,
        progress=progress,
    )
    refused = sum(row["reason"] is not None for row in found)
    table.compact(list(long))
    disagreeing = sum(bool(row["told"]) for row in table.rows().values())
    unchanged, short = len(long) - len(fresh), len(rows) - len(long)
    return Watched(len(fresh), refused, unchanged, short, disagreeing)


def watch_flight(address: str, model: Model, settings: str, asked: bool) -> Row:
    """A row of the table ``twin``. Never raises for what a file holds: that is its ``reason``.

    asked: the user said that all flights are of the model's vehicle.
    """
    row = _row(address, None, settings)

    def told() -> Row:
        with fetched(address) as path:
            row["sha256"] = digest(path)
            return _told(path, model, asked)

    return with_reason(row, told)


def _row(address: str, sha256: str | None, settings: str) -> Row:
    row: Row = dict.fromkeys(COLUMNS)
    return row | {KEY: address, "sha256": sha256, "settings": settings}


def _told(path: Path, model: Model, asked: bool) -> Row:
    from groundstation.recording.craft_family import require_craft_of
    from groundstation.recording.open_recording import open_recording
    from groundstation.twin.twin import episodes_of, in_words

    recording = open_recording(path)
    if not asked:
        require_craft_of(recording, model)
    begun = [one for one in episodes_of(model, [recording.samples]) if one.end_s is None]
    return {
        "told": [in_words(one) for one in begun],
        "first_s": min((one.noticed_s for one in begun), default=None),
    }
