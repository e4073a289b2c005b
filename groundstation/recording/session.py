"""A recording in memory, whatever file it came from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.samples import RawBatch, SampleBatch


@dataclass(frozen=True, slots=True)
class Table:
    """Any other series a file holds (a motion-capture event, say), values as stored.

    time_s: (n,) float64 on the device's clock.
    columns: name -> (n,) array, in the file's own type and unit.
    """

    time_s: NDArray[np.float64]
    columns: dict[str, NDArray[np.generic]]


@dataclass(slots=True)
class Recording:
    """Everything a file says.

    samples: decoded, deduplicated.
    raw: packets as received, or None where the source never had packets or they were not
        asked for.
    commands, events, statistics: dictionaries as recorded, in order of time.
    tables: further series by name; for a microSD log every event of the file, all values.
    metadata: name -> key -> text.
    damage: one line for each thing that could not be read; empty for a sound file.
    being_written: by a recorder, when it was read: more will come.
    """

    path: Path
    kind: str
    """mcap, csv, microsd, parquet, npz, ulog or rosbag."""
    samples: SampleBatch
    raw: RawBatch | None = None
    commands: list[dict[str, Any]] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    statistics: list[dict[str, Any]] = field(default_factory=list)
    tables: dict[str, Table] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)
    being_written: bool = False

    def __repr__(self) -> str:
        more = f", {len(self.damage)} damaged places" if self.damage else ""
        return f"Recording({str(self.path)!r}, {self.kind}: {self.samples!r}{more})"

    @property
    def link(self) -> str:
        """The link that made the recording, or the kind of file where none did."""
        return self.metadata.get("session", {}).get("link", self.kind)
