"""The catalogue of recordings: every file read once, again only when it changed."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError
from groundstation.fleet.facts import COLUMNS, KEY, READER, reading, stamp_of
from groundstation.fleet.gather import gathered
from groundstation.fleet.parts import Parts, Row
from groundstation.identification.fit_record import Progress, silent

SUFFIXES = (".mcap", ".csv", ".npz", ".db3", ".ulg")
"""Of recordings; a microSD log has no suffix of its own and is named itself."""
UNFIT = ("damaged", "bad")
"""States of recordings that nothing is made of."""
SETTLED = ("sha256", "settings")
"""Columns that tell whether a recording was worked on already."""
KEPT_AT = 200
"""Rows that make a file of their own."""


@dataclass(frozen=True, slots=True)
class Indexed:
    """Counts of one run. gone: rows whose file is no longer there."""

    read: int
    unchanged: int
    damaged: int
    gone: int


def recordings_table(catalogue: Path) -> Parts:
    return Parts(catalogue / "recordings", COLUMNS, KEY)


def recordings_of(catalogue: Path, columns: Sequence[str] | None = None) -> list[Row]:
    """The rows of a catalogue, or only these columns and the address of each.

    Raises BadInputError where there is none.
    """
    rows = recordings_table(catalogue).rows(columns)
    if not rows:
        raise BadInputError(
            f"{catalogue}: no catalogue; make one with: groundstation fleet index FOLDER -o"
            f" {catalogue}"
        )
    return list(rows.values())


def usable(rows: Iterable[Row]) -> list[Row]:
    """Those of a catalogue's rows that something can be made of, each flight once: of recordings
    with one content the first by address, for a flight that counts twice scatters too little."""
    fit = [one for one in rows if one["state"] not in UNFIT]
    firsts: dict[str, str] = {}
    for one in fit:
        first = firsts.setdefault(one["sha256"], one[KEY])
        firsts[one["sha256"]] = min(first, one[KEY])
    return [one for one in fit if firsts[one["sha256"]] == one[KEY]]


def lasting(rows: Iterable[Row], least_s: float) -> list[Row]:
    """Those with so much time in the air."""
    return [one for one in rows if (one["airborne_s"] or 0.0) >= least_s]


def changed_since(known: Mapping[str, Row], rows: Mapping[str, Row], settings: str) -> list[str]:
    """Addresses of recordings that an earlier table does not know, or knows with other content or
    settings."""
    return [
        address
        for address, row in rows.items()
        if address not in known
        or (known[address]["sha256"], known[address]["settings"]) != (row["sha256"], settings)
    ]


def addresses_of(sources: Sequence[str]) -> list[str]:
    """Every recording below folders, matching globs, and those that are named themselves.

    Local addresses come out absolute, so that a worker with another working folder finds them.

    Raises BadInputError for a source that holds none.
    """
    found: set[str] = set()
    for source in sources:
        below = set(_remote(source) if "://" in source else _local(source))
        if not below:
            raise BadInputError(f"{source}: no recordings here ({', '.join(SUFFIXES)})")
        found |= below
    return sorted(found)


def _local(source: str) -> Iterable[str]:
    path = Path(source)
    if path.is_file():
        return [str(path.absolute())]
    if path.is_dir():
        return [
            str(Path(folder, name).absolute())
            for folder, _, names in os.walk(path)
            for name in names
            if name.endswith(SUFFIXES)
        ]
    import glob

    return [
        str(Path(one).absolute())
        for one in glob.glob(source, recursive=True)
        if os.path.isfile(one)
    ]


def _remote(source: str) -> Iterable[str]:
    try:
        import fsspec

        system, path = fsspec.core.url_to_fs(source)
        names = (
            [path]
            if system.isfile(path)
            else (system.glob(path) if "*" in path else system.find(path))
        )
    except (ImportError, ValueError, OSError) as error:
        raise BadInputError(f"{source}: cannot be listed: {error}") from error
    return [system.unstrip_protocol(one) for one in names if one.endswith(SUFFIXES)]


def index(
    catalogue: Path,
    sources: Sequence[str],
    *,
    vehicle: str | None = None,
    workers: int,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> Indexed:
    """Bring the catalogue up to date with what the sources hold.

    vehicle: profile of all crafts, a name or a file; None: what each recording names. Rows of other
    sources stay. A file that is gone loses its row.

    Raises BadInputError for a profile that there is not.
    """
    if vehicle is not None:
        load_vehicle(vehicle)
    table = recordings_table(catalogue)
    known = table.rows(["stamp", "reader", "asked_vehicle"])
    addresses = addresses_of(sources)
    changed = [one for one in addresses if one not in known or _changed(known[one], vehicle)]
    rows = gathered(
        table,
        reading(vehicle),
        changed,
        partial(_deadly, vehicle=vehicle),
        at_once=KEPT_AT,
        doing="reading",
        workers=workers,
        scheduler=scheduler,
        progress=progress,
    )
    damaged = sum(row["state"] == "damaged" for row in rows)
    listed = tuple(filter(None, map(_remote_folder, sources)))
    gone = {one for one in known.keys() - set(addresses) if _gone(one, listed)}
    table.compact(sorted((known.keys() | set(addresses)) - gone))
    return Indexed(len(changed), len(addresses) - len(changed), damaged, len(gone))


def _changed(row: Row, vehicle: str | None) -> bool:
    if (row["reader"], row["asked_vehicle"]) != (READER, vehicle):
        return True
    try:
        return bool(stamp_of(row[KEY]) != row["stamp"])
    except (OSError, ImportError):
        return True


def _gone(address: str, listed: tuple[str, ...]) -> bool:
    """Whether a recording that no source holds any more is no longer there. listed: remote folders
    that were just looked through; what lies elsewhere is not asked for one by one."""
    return address.startswith(listed) if "://" in address else not os.path.exists(address)


def _remote_folder(source: str) -> str | None:
    if "://" not in source or "*" in source:
        return None
    import fsspec

    system, path = fsspec.core.url_to_fs(source)
    return str(system.unstrip_protocol(path)).rstrip("/") + "/"


def _deadly(address: str, vehicle: str | None) -> Row:
    """The row of a recording that every process dies of."""
    row: Row = dict.fromkeys(COLUMNS)
    with suppress(OSError, ImportError):  # until it changes it is not read again
        row["stamp"] = stamp_of(address)
    return row | {
        KEY: address,
        "reader": READER,
        "asked_vehicle": vehicle,
        "state": "damaged",
        "reason": "the process that reads it dies, again and again; it is set aside",
    }
