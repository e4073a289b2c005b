"""The catalogue of recordings: the facts of each file, read once, again only when it changed."""

from __future__ import annotations

import glob
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from operator import itemgetter
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import numpy as np

from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError, GroundStationError
from groundstation.fleet.engine import Parts, Row, gathered, set_aside
from groundstation.identification.estimate import Progress, silent
from groundstation.paths import digest, require_content

if TYPE_CHECKING:
    from groundstation.recording.session import Recording

# What one recording is, for the catalogue: of which craft, from when, how good.


COLUMNS = {
    "address": "text",
    "bytes": "count",
    "stamp": "text",
    "reader": "count",
    "sha256": "text",
    "craft": "text",
    "vehicle": "text",
    "asked_vehicle": "text",
    "firmware": "text",
    "link": "text",
    "begun": "text",
    "duration_s": "number",
    "airborne_s": "number",
    "rate_hz": "number",
    "lost": "count",
    "battery_first_v": "number",
    "battery_last_v": "number",
    "channels": "texts",
    "state": "text",
    "reason": "text",
}
"""Of the catalogue's table ``recordings``. stamp: what changes when the file does; reader: the
``READER`` that read it; state: good, usable, bad or damaged; reason: the verdict's, or why it could
not be read. begun: UTC, ISO 8601."""
READER = 3
"""Counts up when a row comes to hold more or other things: rows of older readers are read again."""
KEY = "address"

DATED = re.compile(r"(\d{4}-\d\d-\d\d)T(\d\d)-(\d\d)-(\d\d)")
"""Names as the daemon gives them."""
RADIO = re.compile(r"radio://[^/]+/\d+/\w+/([0-9A-Fa-f]+)")
"""Dongle, channel, rate, address."""
FACTORY_ADDRESS = "E7E7E7E7E7"
"""Of every Crazyflie that was not given another, and so of none."""
YEAR_2000_NS = 946_684_800 * 10**9
"""Earlier ones are a clock that was never set."""
LEAST_AIR_S = 4.0


def facts_of(address: str, vehicle: str | None = None) -> Row:
    """A row of the catalogue. Never raises for what a file holds: that is its ``reason``.

    vehicle: a profile's name or file; None: what the recording names, or else crazyflie1.
    """
    row = _row_of(address, vehicle)
    try:
        row["stamp"] = stamp_of(address)
        with fetched(address) as path:
            require_content(path)
            row |= {"bytes": path.stat().st_size, "sha256": digest(path)}
            row |= _described(path, address, vehicle)
    except GroundStationError as error:
        row |= {"state": "damaged", "reason": str(error)}
    except OSError as error:
        row |= {"state": "damaged", "reason": f"cannot be read: {error.strerror or error}"}
    except Exception as error:  # a fault of ours with one file must not end a thousand others
        row |= {"state": "damaged", "reason": f"{type(error).__name__}: {error}"}
    return row


def _row_of(address: str, vehicle: str | None) -> Row:
    row: Row = dict.fromkeys(COLUMNS)
    return row | {KEY: address, "reader": READER, "asked_vehicle": vehicle}


def stamp_of(address: str) -> str:
    """What changes when a file does, told without reading it. Raises OSError."""
    if "://" not in address:
        stat = os.stat(address)
        return f"{stat.st_size}-{stat.st_mtime_ns}"
    import fsspec

    system, path = fsspec.core.url_to_fs(address)
    return str(system.ukey(path))


@contextmanager
def fetched(address: str) -> Iterator[Path]:
    """A recording as a local file: itself, or a copy for as long as it is needed of one that
    fsspec reads (``s3://``, ``sftp://``), with the date at which that was modified.

    Raises BadInputError where that package is missing.
    """
    if "://" not in address:
        yield Path(address)
        return
    try:
        import fsspec

        opened = fsspec.open(address, "rb")
    except ImportError as error:
        raise BadInputError(f"{address}: needs a package that is not here: {error}") from error
    with tempfile.TemporaryDirectory(prefix="groundstation-") as folder:
        local = Path(folder, PurePosixPath(address).name)
        with opened as source, local.open("wb") as copy:
            shutil.copyfileobj(source, copy)
        try:
            modified = opened.fs.modified(opened.path).timestamp()
        except (NotImplementedError, OSError):
            modified = 0.0  # not known: rather none than the date of the copy
        os.utime(local, (modified, modified))
        try:
            yield local
        except GroundStationError as error:  # the copy has another name each time
            error.args = (str(error).replace(str(local), address),)
            raise


def _described(path: Path, address: str, vehicle: str | None) -> Row:
    from groundstation.recording.formats import open_recording
    from groundstation.recording.quality import inspect_recording

    recording = open_recording(path)
    report = inspect_recording(recording)
    samples = recording.samples
    metadata = recording.metadata
    grade, _, reason = str(report["verdict"]).partition(": ")
    battery = samples.battery_v[np.isfinite(samples.battery_v)]
    return {
        "craft": _craft(metadata, address),
        "vehicle": vehicle or metadata.get("vehicle", {}).get("profile"),
        "firmware": metadata.get("craft", {}).get("firmware"),
        "link": recording.link,
        "begun": _begun(recording, address, path),
        "duration_s": float(report["duration_s"]),
        "airborne_s": _airborne_s(recording),
        "rate_hz": float(report["rate_hz"]),
        "lost": int(report["lost_samples"]),
        "battery_first_v": float(battery[0]) if len(battery) else None,
        "battery_last_v": float(battery[-1]) if len(battery) else None,
        "channels": sorted(set(report["ranges"]) - set(report["missing"])),
        "state": grade.split(",")[0],
        "reason": reason,
    }


def _craft(metadata: dict[str, dict[str, str]], address: str) -> str:
    """Whose flight it is: the address of its radio if it was given one of its own, or else the
    folder that it lies in."""
    radio = RADIO.match(metadata.get("session", {}).get("link", ""))
    if radio and radio[1].upper() != FACTORY_ADDRESS:
        return radio[1].upper()
    return PurePosixPath(address).parent.name or "unnamed"


def _begun(recording: Recording, address: str, path: Path) -> str:
    """UTC from the file's name, or from its first sample, or from the file itself."""
    named = DATED.search(PurePosixPath(address).name)
    if named:
        day, *clock = named.groups()
        return f"{day}T{':'.join(clock)}+00:00"
    from groundstation.recording.session import SYNTHESISED

    samples = recording.samples
    if len(samples) and recording.metadata.get("host_time") != SYNTHESISED:
        first = int(samples.host_time_ns[0])
        if first > YEAR_2000_NS:
            return datetime.fromtimestamp(first * 1e-9, UTC).isoformat(timespec="seconds")
    return datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(timespec="seconds")


def _airborne_s(recording: Recording) -> float:
    """Of stretches that are long enough for a fit."""
    from groundstation.identification.flight import airborne
    from groundstation.identification.runs import bridged

    try:
        flights = bridged(recording.samples, recording.path.name, LEAST_AIR_S)
    except BadInputError:
        return 0.0
    return float(sum(airborne(run).sum() * run.period_s for run in flights))


# The catalogue of recordings: every file read once, again only when it changed.


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
    firsts = {one["sha256"]: one[KEY] for one in sorted(fit, key=itemgetter(KEY), reverse=True)}
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
    matches = map(Path, glob.glob(source, recursive=True))
    return [str(one.absolute()) for one in matches if one.is_file()]


def _remote(source: str) -> Iterable[str]:
    try:
        import fsspec

        system, path = fsspec.core.url_to_fs(source)
        names = [path]
        if not system.isfile(path):
            names = system.glob(path) if "*" in path else system.find(path)
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
        partial(facts_of, vehicle=vehicle),
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
    row = set_aside(_row_of(address, vehicle) | {"state": "damaged"}, "reads")
    with suppress(OSError, ImportError):  # until it changes it is not read again
        row["stamp"] = stamp_of(address)
    return row
