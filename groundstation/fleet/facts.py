"""What one recording is, for the catalogue: of which craft, from when, how good."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import numpy as np

from groundstation.errors import BadInputError, GroundStationError
from groundstation.fleet.parts import Row
from groundstation.paths import digest, require_content

if TYPE_CHECKING:
    from groundstation.recording.session import Recording

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


def reading(vehicle: str | None) -> partial[Row]:
    """``facts_of``, for a worker."""
    return partial(facts_of, vehicle=vehicle)


def facts_of(address: str, vehicle: str | None = None) -> Row:
    """A row of the catalogue. Never raises for what a file holds: that is its ``reason``.

    vehicle: a profile's name or file; None: what the recording names, or else crazyflie1.
    """
    row: Row = dict.fromkeys(COLUMNS)
    row |= {"address": address, "reader": READER, "asked_vehicle": vehicle}
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
