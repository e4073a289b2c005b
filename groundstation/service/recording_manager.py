"""What an operator wants recorded, kept true: rotation, resuming, retention."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import os
import re
import time
from collections.abc import Callable, Coroutine
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from groundstation.errors import BadInputError, GroundStationError
from groundstation.links.command import HostClock, LinkEvent, steady_clock
from groundstation.paths import dated
from groundstation.recording.mcap_file import McapRecorder, RecorderStatus, session_metadata
from groundstation.recording.mcap_scan import catalogue
from groundstation.service.config import MEBIBYTE, RecordingConfig
from groundstation.telemetry.decoder import LinkStatistics
from groundstation.telemetry.samples import LogTable, RawBatch, SampleBatch

if TYPE_CHECKING:
    from groundstation.twin.twin import Shown

# One recording after another: names, metadata, start, stop, and the next part.


OUR_NAME = re.compile(r"\d{4}-\d\d-\d\dT\d\d-\d\d-\d\d-\d{3}Z_[a-z-]+\.mcap")
"""What ``Sessions`` calls its files: they sort by time, also where the clock was set back."""
NOTHING_RECORDED = "nothing is being recorded; 'groundstation record start' begins a recording"


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
            raise BadInputError(NOTHING_RECORDED)

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


CHECK_S = 1.0
RESUME_FIRST_S, RESUME_MOST_S = 0.5, 30.0
RESUME_LEAST_BYTES = 16 * MEBIBYTE
"""A recording is not resumed on a disk with less room than this, whatever the low-space mark."""
RETAIN_S = 60.0

Note = Callable[[str, str], None]


class RecordingManager:
    """Starts and stops recordings, goes on in a new file when one is long enough or has failed,
    and deletes the oldest where the configuration says so.

    sessions: what is written to. link: name of the telemetry link of the moment. settle: gives
    out what the decoder still holds. note: told (kind, text).
    """

    def __init__(
        self,
        sessions: Sessions,
        config: RecordingConfig,
        *,
        link: Callable[[], str],
        settle: Callable[[], None],
        note: Note,
    ) -> None:
        self.sessions = sessions
        self.rotations = self.resumed = self.deleted = 0
        self._config = config
        self._link, self._settle, self._note = link, settle, note
        self._wanted = False
        self._began_s = 0.0
        self._retry_s, self._retry_at_s, self._told = RESUME_FIRST_S, 0.0, ""
        self._retain_at_s = 0.0
        self._stuck: list[str] = []  # what retention could not delete
        self._lock = asyncio.Lock()  # held while a recording is begun or finished
        self._finishing: set[asyncio.Task[Any]] = set()
        self._look = asyncio.Event()
        self._free: int | None = None

    async def start(self) -> Path:
        """Begin a new session. Raises BadInputError when one is being recorded."""
        async with self._lock:
            self.sessions.require_idle()
            return await self._start()

    async def ensure(self) -> None:
        """Begin a session, unless one is wanted already."""
        async with self._lock:
            if not self._wanted:
                await self._start()

    async def stop(self) -> dict[str, Any]:
        """Finish the file; its final status. Raises BadInputError when there is none."""
        async with self._lock:
            self.sessions.require_started()
            # the samples of the packets in this file, not in the next one
            self._settle()
            self._wanted = False
            self._note("recording", "recording stopped")
            await self._finish(self.sessions.detach())
            return self.sessions.status()

    async def close(self) -> None:
        """Finish what is being recorded, if anything."""
        async with self._lock:
            self._wanted = False
            await self._finish(self.sessions.detach())
            await asyncio.gather(*self._finishing, return_exceptions=True)

    async def _start(self) -> Path:
        self.sessions.detach()  # one that has failed ends by itself: nothing to wait for
        path = self._begin(await self._create(continues=False))
        self._wanted = True
        self._note("recording", f"recording to {path}")
        return path

    def require_recording(self) -> None:
        """Raises BadInputError where a mark would not be recorded."""
        if self.sessions.status()["state"] != "recording":
            raise BadInputError(NOTHING_RECORDED)

    def entries(self) -> list[dict[str, Any]]:
        """The folder's recordings. Reads files: not for the event loop."""
        status = self.sessions.status()
        writing = Path(status["file"]) if status["state"] == "recording" else None
        return [entry.as_dict() for entry in catalogue(self.sessions.folder, recording=writing)]

    def status(self) -> dict[str, Any]:
        return {
            **self.sessions.status(),
            "wanted": self._wanted,
            "rotations": self.rotations,
            "resumed": self.resumed,
            "deleted": self.deleted,
            "free_mb": None if self._free is None else round(self._free / 1e6, 1),
        }

    def wake(self) -> None:
        """Something happened to the file: look now."""
        self._look.set()

    async def keep(self) -> None:
        """Look after the recording for as long as the daemon runs."""
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CHECK_S):
                    await self._look.wait()
            self._look.clear()
            self._free = await asyncio.to_thread(_free_bytes, self.sessions.folder)
            async with self._lock:
                if self._wanted:
                    await self._look_after()
            if time.monotonic() >= self._retain_at_s:
                # no file is begun meanwhile that would not be known as a present one
                async with self._lock:
                    await self._retain()

    async def _look_after(self) -> None:
        status, config = self.sessions.status(), self._config
        by_size = 0 < config.rotate_mb * MEBIBYTE <= status["bytes"]
        by_time = 0 < config.rotate_minutes * 60.0 <= time.monotonic() - self._began_s
        if status["state"] != "recording":
            await self._resume(status["state"])
        elif by_size or by_time:
            recorder = await self._next("recording cannot go on in a new file")
            if recorder is None:
                return
            ended = self.sessions.detach()  # nothing may come between this
            path = self._begin(recorder)  # and this
            self.rotations += 1
            self._note("recording", f"recording continues in {path}")
            self._retain_at_s = 0.0
            self._later(self._finish(ended))

    async def _next(self, otherwise: str) -> McapRecorder | None:
        """A recorder for the next part; None, with growing pauses, where there can be none."""
        now_s = time.monotonic()
        if now_s < self._retry_at_s:
            return None
        self._retry_at_s = now_s + self._retry_s
        self._retry_s = min(2 * self._retry_s, RESUME_MOST_S)
        try:
            return await self._create(continues=True)
        except (GroundStationError, OSError) as error:
            reason = OUR_NAME.sub("", str(error))  # each attempt has another file name
            if reason != self._told:
                self._told = reason
                self._note("fault", f"{otherwise}: {error}")
            return None

    async def _create(self, *, continues: bool) -> McapRecorder:
        """A recorder, made where a slow disk holds up nobody."""
        link = self._link()
        making = asyncio.create_task(
            asyncio.to_thread(lambda: self.sessions.create(link, continues=continues))
        )
        try:
            return await asyncio.shield(making)
        except asyncio.CancelledError:
            self._later(self._undo(making))
            raise

    async def _undo(self, making: asyncio.Task[McapRecorder]) -> None:
        """The daemon ended while a file was being made: it holds nothing, and goes."""
        recorder = await making
        status = await asyncio.to_thread(recorder.finish)
        status.file.unlink(missing_ok=True)

    def _later(self, work: Coroutine[Any, Any, None]) -> None:
        """Do it in the background, by the end of the daemon at the latest."""
        task = asyncio.create_task(work)
        self._finishing.add(task)
        task.add_done_callback(self._finishing.discard)

    def _begin(self, recorder: McapRecorder) -> Path:
        self._began_s = time.monotonic()
        self._retry_s, self._retry_at_s, self._told = RESUME_FIRST_S, 0.0, ""
        return self.sessions.install(recorder)

    async def _resume(self, state: str) -> None:
        """Go on after a fault, once it can work."""
        low_bytes = self.sessions.low_space_bytes
        needed = max(2 * low_bytes, low_bytes + RESUME_LEAST_BYTES)
        if self._free is not None and self._free < needed:
            return
        recorder = await self._next("recording cannot be resumed")
        if recorder is None:
            return
        self.sessions.detach()
        path = self._begin(recorder)
        self.resumed += 1
        self._note("recording", f"recording resumed after '{state}': {path}")

    async def _finish(self, recorder: McapRecorder | None) -> None:
        if recorder is not None:
            await asyncio.to_thread(self.sessions.finish, recorder)

    async def _retain(self) -> None:
        self._retain_at_s = time.monotonic() + RETAIN_S
        keep = round(self._config.keep_mb * MEBIBYTE)
        if keep <= 0:
            return
        present = {path.name for path in self.sessions.present()}
        folder = self.sessions.folder
        try:
            deleted, stuck = await asyncio.to_thread(delete_oldest, folder, keep, present)
        except OSError as error:
            deleted, stuck = [], [f"{folder}: {error.strerror}"]
        self.deleted += len(deleted)
        for name in deleted:
            self._note("deleted", f"{name}: the recordings need more than {keep / 1e6:.0f} MB")
        if stuck and stuck != self._stuck:
            self._note("fault", f"not deleted, though there is too much: {'; '.join(stuck)}")
        self._stuck = stuck


def delete_oldest(folder: Path, keep_bytes: int, present: set[str]) -> tuple[list[str], list[str]]:
    """Delete recordings of ours, oldest first, until the rest needs at most ``keep_bytes``; their
    names, and what could not be deleted with the reason.

    Never a present one, nor one that another daemon is writing, and nothing that has another name
    than we give.
    """
    if not os.path.isdir(folder):
        return [], []
    found = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if OUR_NAME.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                with contextlib.suppress(FileNotFoundError):  # deleted meanwhile
                    found.append((entry.name, entry.stat(follow_symlinks=False).st_size))
    total = sum(size for _, size in found)
    deleted, stuck = [], []
    for name, size in sorted(found):
        if total <= keep_bytes:
            break
        if name in present:
            continue
        try:
            _delete(folder / name)
        except OSError as error:
            stuck.append(f"{name}: {error.strerror}")
        else:
            total -= size
            deleted.append(name)
    return deleted, stuck


def _delete(path: Path) -> None:
    """Delete a file. Raises OSError where that fails or somebody is still writing it."""
    fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        path.unlink()
    except BlockingIOError as error:
        raise OSError(error.errno, "is still being written") from error
    finally:
        os.close(fd)


def _free_bytes(folder: Path) -> int | None:
    """What is free where ``folder`` is or will be; None where that cannot be told."""
    for place in (folder, *folder.absolute().parents):
        with contextlib.suppress(OSError):
            space = os.statvfs(place)
            return space.f_bavail * space.f_frsize
    return None
