"""One recording after another: names, metadata, start and stop."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from groundstation.errors import BadInputError, GroundStationError
from groundstation.links.base import LinkEvent
from groundstation.recording.mcap_writer import McapRecorder, RecorderStatus
from groundstation.recording.recording_file import session_metadata
from groundstation.telemetry.samples import RawBatch, SampleBatch


class Sessions:
    """The recorder of the moment, if any; everything is handed to it without blocking.

    ``finish`` waits for the disk and may be called from another thread than the rest, with what
    ``detach`` gave: a new recording can begin meanwhile.

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
        self._ended: McapRecorder | None = None  # the last one
        self._last: RecorderStatus | None = None
        self.faults: dict[Path, str] = {}
        """What kept a recording from being complete, by file."""

    def start(self, link: str) -> Path:
        """Begin a new file named after the time and the link."""
        if self._recorder is not None and self._recorder.status().state == "recording":
            raise BadInputError(f"already recording to {self._recorder.status().file}")
        self.detach()  # one that has failed ends by itself: nothing to wait for
        path = self._free_name(link)
        self._recorder = McapRecorder(
            path,
            {"session": session_metadata(link), **self._metadata},
            low_space_bytes=self._low_space_bytes,
            on_fault=partial(self._fault, path),
        )
        return path

    @property
    def fault(self) -> str:
        """The latest of ``faults``, or nothing."""
        return next(reversed(self.faults.values()), "")

    def require_started(self) -> None:
        """Raises BadInputError when there is nothing to stop."""
        if self._recorder is None:
            raise BadInputError(
                "nothing is being recorded; 'groundstation record start' begins a recording"
            )

    def detach(self) -> McapRecorder | None:
        """Record no more; the recorder that is to be finished, None when there was none."""
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            self._ended, self._last = recorder, recorder.status()
        return recorder

    def finish(self, recorder: McapRecorder) -> RecorderStatus:
        """Finish the file of a detached recorder. Blocks until the disk has it."""
        status = recorder.finish()
        if recorder is self._ended:
            self._last = status
        return status

    def stop(self) -> RecorderStatus | None:
        """``detach`` and ``finish``; None when nothing was being recorded."""
        recorder = self.detach()
        return None if recorder is None else self.finish(recorder)

    def wait(self) -> None:
        """Finish what is recorded or being finished, from whatever thread: the last resort."""
        for recorder in (self._recorder, self._ended):
            if recorder is not None:
                recorder.finish()

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

    def _fault(self, path: Path, text: str) -> None:
        self.faults[path] = text
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
