"""The catalogue of recordings: every file read once, again only when it changed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from groundstation.errors import BadInputError
from groundstation.fleet.engine import carried_out
from groundstation.fleet.facts import COLUMNS, KEY, facts_of, stamp_of
from groundstation.fleet.parts import Parts, Row

SUFFIXES = (".mcap", ".csv", ".npz", ".rrd", ".db3", ".ulg")
"""Of recordings; a microSD log has no suffix of its own and is named itself."""
KEPT_AT = 200
"""Results that make a file of their own: what a run that is killed loses at most."""
Told = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class Indexed:
    """Counts of one run. gone: rows whose file is no longer there."""

    read: int
    unchanged: int
    damaged: int
    gone: int


def recordings_table(catalogue: Path) -> Parts:
    return Parts(catalogue / "recordings", COLUMNS, KEY)


def recordings_of(catalogue: Path) -> list[Row]:
    """The rows of a catalogue. Raises BadInputError where there is none."""
    rows = recordings_table(catalogue).rows()
    if not rows:
        raise BadInputError(
            f"{catalogue}: no catalogue; make one with: groundstation fleet index FOLDER -o"
            f" {catalogue}"
        )
    return list(rows.values())


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
    workers: int,
    scheduler: str | None = None,
    progress: Told = lambda _share, _what: None,
) -> Indexed:
    """Bring the catalogue up to date with what the sources hold.

    Rows of other sources stay. A file that is gone loses its row.
    """
    table = recordings_table(catalogue)
    known = table.rows()
    addresses = addresses_of(sources)
    changed = [one for one in addresses if one not in known or _changed(known[one])]
    fresh: list[Row] = []
    damaged = 0
    for count, (address, row) in enumerate(
        carried_out(facts_of, changed, workers=workers, scheduler=scheduler), 1
    ):
        fresh.append(row or _deadly(address))
        damaged += fresh[-1]["state"] == "damaged"
        if len(fresh) >= KEPT_AT:
            table.append(fresh)
            fresh = []
        progress(count / len(changed), f"reading {count} of {len(changed)}")
    table.append(fresh)
    here = [one for one in table.rows() if one in set(addresses) or _there(one)]
    gone = len(known.keys() | set(addresses)) - len(here)
    table.compact(here)
    return Indexed(len(changed), len(addresses) - len(changed), damaged, gone)


def _changed(row: Row) -> bool:
    try:
        return bool(stamp_of(row[KEY]) != row["stamp"])
    except (OSError, ImportError):
        return True


def _there(address: str) -> bool:
    return "://" in address or os.path.exists(address)


def _deadly(address: str) -> Row:
    """The row of a recording that every process dies of."""
    row: Row = dict.fromkeys(COLUMNS)
    return row | {
        KEY: address,
        "state": "damaged",
        "reason": "the process that reads it dies, again and again; it is set aside",
    }
