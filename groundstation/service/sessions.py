"""One recording after another: names, metadata, start and stop."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from groundstation.errors import BadInputError, GroundStationError
from groundstation.links.base import LinkEvent
from groundstation.recording.mcap_writer import McapRecorder, RecorderStatus
from groundstation.recording.recording_file import session_metadata
from groundstation.telemetry.samples import RawBatch, SampleBatch


class Sessions:
    """The recorder of the moment, if any; everything is handed to it without blocking.

    ``stop`` waits for the disk and may be called from another thread than the rest.

    folder: where files go; created when needed.
    metadata: text for the file's ``vehicle`` and ``configuration`` records.
    """

    def __init__(
        self,
        folder: Path,
        metadata: dict[str, dict[str, str]],
        *,
        low_space_bytes: int,
        on_fault: Callable[[str], None],
    ) -> None:
        self.folder = folder
        self._metadata = metadata
        self._low_space_bytes = low_space_bytes
        self._on_fault = on_fault
        self._recorder: McapRecorder | None = None
        self._last: RecorderStatus | None = None
        self.fault = ""
        """What kept a recording from being complete, if anything did."""

    def start(self, link: str) -> Path:
        """Begin a new file named after the time and the link."""
        if self._recorder is not None and self._recorder.status().state == "recording":
            raise BadInputError(f"already recording to {self._recorder.status().file}")
        self.stop()
        path = self._free_name(link)
        self._recorder = McapRecorder(
            path,
            {"session": session_metadata(link), **self._metadata},
            low_space_bytes=self._low_space_bytes,
            on_fault=self._fault,
        )
        return path

    def require_started(self) -> None:
        """Raises BadInputError when there is nothing to stop."""
        if self._recorder is None:
            raise BadInputError(
                "nothing is being recorded; 'groundstation record start' begins a recording"
            )

    def stop(self) -> RecorderStatus | None:
        """Finish the file; None when nothing was being recorded."""
        recorder = self._recorder
        if recorder is None:
            return None
        # first, so that what comes while the file is finished is not counted as lost
        self._recorder = None
        self._last = recorder.status()
        self._last = recorder.finish()
        return self._last

    def raw(self, batch: RawBatch) -> None:
        if recorder := self._recorder:
            recorder.raw(batch)

    def samples(self, batch: SampleBatch) -> None:
        if recorder := self._recorder:
            recorder.samples(batch)

    def event(self, event: LinkEvent) -> None:
        if recorder := self._recorder:
            recorder.event(asdict(event))

    def statistics(self, entry: dict[str, Any]) -> None:
        if recorder := self._recorder:
            recorder.statistics(entry)

    def command(self, entry: dict[str, Any]) -> None:
        if recorder := self._recorder:
            recorder.command(entry)

    def status(self) -> dict[str, Any]:
        """file, bytes, samples of the present recording, or of the last one, and its state."""
        recorder = self._recorder
        status = recorder.status() if recorder else self._last
        if status is None:
            return {"state": "off", "file": None, "bytes": 0, "samples": 0, "dropped": 0}
        return {
            "state": status.state,
            "file": str(status.file),
            "bytes": status.bytes,
            "samples": status.samples,
            "raw_packets": status.raw_packets,
            "dropped": status.dropped,
            "text": status.text,
        }

    def _fault(self, text: str) -> None:
        self.fault = text
        self._on_fault(text)

    def _free_name(self, link: str) -> Path:
        stamp = time.strftime("%Y-%m-%dT%H-%M-%SZ", time.gmtime())
        kind = link.split(":", 1)[0]
        for attempt in range(1, 1000):
            suffix = "" if attempt == 1 else f"-{attempt}"
            path = self.folder / f"{stamp}_{kind}{suffix}.mcap"
            if not path.exists():
                return path
        raise GroundStationError(f"{self.folder}: a thousand recordings in one second; wait")
