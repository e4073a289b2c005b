"""One recording after another: names, metadata, start, stop, and the next part."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from groundstation.errors import BadInputError
from groundstation.links.command import HostClock, LinkEvent, steady_clock
from groundstation.paths import dated
from groundstation.recording.mcap_file import session_metadata
from groundstation.recording.mcap_writer import McapRecorder, RecorderStatus
from groundstation.telemetry.decoder import LinkStatistics
from groundstation.telemetry.samples import LogTable, RawBatch, SampleBatch

if TYPE_CHECKING:
    from groundstation.twin.twin import Shown

OUR_NAME = re.compile(r"\d{4}-\d\d-\d\dT\d\d-\d\d-\d\d-\d{3}Z_[a-z-]+\.mcap")
"""What ``Sessions`` calls its files: they sort by time, also where the clock was set back."""


class Sessions:
    """The recorder of the moment, if any; everything is handed to it without blocking.

    ``finish`` waits for the disk and may be called from another thread than the rest, with what
    ``detach`` gave: a new recording can begin meanwhile. So may ``create``.

    folder: where files go; created when needed.
    metadata: text for the file's ``vehicle`` and ``configuration`` records.
    clock: names files.
    """

    def __init__(
        self,
        folder: Path,
        metadata: dict[str, dict[str, str]],
        *,
        low_space_bytes: int,
        on_fault: Callable[[str], None],
        clock: HostClock | None = None,
    ) -> None:
        self.folder = folder
        self.low_space_bytes = low_space_bytes
        self._metadata = metadata
        self._on_fault = on_fault
        self._clock = clock or steady_clock()
        self._recorder: McapRecorder | None = None
        self._ended: McapRecorder | None = None  # the last one
        self._last: RecorderStatus | None = None
        self._session = ""
        self._part = 0
        self.faults: dict[Path, str] = {}
        """What kept a recording from being complete, by file."""

    def create(self, link: str, *, continues: bool = False) -> McapRecorder:
        """A recorder for a new file: of a new session, or the next part of the present one."""
        path = dated(self.folder, f"{link.split(':', 1)[0]}.mcap", self._clock())
        session, part = (self._session, self._part + 1) if continues else (path.stem, 1)
        recorder = McapRecorder(
            path,
            {
                "session": {**session_metadata(link), "session": session, "part": str(part)},
                **self._metadata,
            },
            low_space_bytes=self.low_space_bytes,
            on_fault=partial(self._fault, path),
        )
        self._session, self._part = session, part
        return recorder

    def install(self, recorder: McapRecorder) -> Path:
        """From now on everything goes into ``recorder``; where it goes."""
        self._recorder = recorder
        return recorder.status().file

    def require_idle(self) -> None:
        """Raises BadInputError while a file is being written."""
        if self._recorder is not None and self._recorder.status().state == "recording":
            raise BadInputError(f"already recording to {self._recorder.status().file}")

    def require_started(self) -> None:
        """Raises BadInputError when there is nothing to stop."""
        if self._recorder is None:
            raise BadInputError(
                "nothing is being recorded; 'groundstation record start' begins a recording"
            )

    def present(self) -> list[Path]:
        """Files that are being written or finished."""
        return [each.status().file for each in (self._recorder, self._ended) if each is not None]

    def detach(self) -> McapRecorder | None:
        """Record no more; the recorder that is to be finished, None when there was none."""
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            self._ended, self._last = recorder, recorder.status()
        return recorder

    def finish(self, recorder: McapRecorder) -> RecorderStatus:
        """Write what ``recorder`` still has and sync it; its last status."""
        status = recorder.finish()
        if recorder is self._ended:
            self._last = status
        return status

    def wait(self) -> None:
        """Finish what is recorded or being finished, from whatever thread: the last resort."""
        for recorder in (self._recorder, self._ended):
            if recorder is not None:
                recorder.finish()

    def split(self) -> None:
        """What follows comes from another link."""
        if recorder := self._recorder:
            recorder.split()

    def raw(self, batch: RawBatch) -> None:
        if recorder := self._recorder:
            recorder.raw(batch)

    def samples(self, batch: SampleBatch) -> None:
        if recorder := self._recorder:
            recorder.samples(batch)

    def note(self, note: LinkEvent | LinkStatistics | LogTable | Shown) -> None:
        recorder = self._recorder
        if recorder is None:
            return
        match note:
            case LinkEvent():
                recorder.event(asdict(note))
            case LinkStatistics():
                recorder.statistics(note.as_dict())
            case LogTable():
                recorder.table(note)

    def command(self, entry: dict[str, Any]) -> None:
        if recorder := self._recorder:
            recorder.command(entry)

    @property
    def fullness(self) -> float:
        """How full the recorder's queue is, 0..1."""
        recorder = self._recorder
        return recorder.fullness if recorder else 0.0

    def status(self) -> dict[str, Any]:
        """file, bytes, samples of the present recording, or of the last one, and its state.

        path: the file, for programs that run in another folder."""
        recorder = self._recorder
        status = recorder.status() if recorder else self._last
        if status is None:
            return {"state": "off", "file": None, "bytes": 0, "samples": 0, "dropped": 0}
        return {
            "state": status.state,
            "file": str(status.file),
            "path": str(status.file.absolute()),
            "bytes": status.bytes,
            "samples": status.samples,
            "raw_packets": status.raw_packets,
            "dropped": status.dropped,
            "text": status.text,
        }

    def _fault(self, path: Path, text: str) -> None:
        self.faults[path] = text
        self._on_fault(text)
