"""The daemon's side of the live view: hands data over, never waits, keeps the rest alive.

daemon -> socket -> feeder (loads rerun) -> rerun server -> relay -> any number of viewers.
Everything right of the daemon may block, grow, be stopped or die; the daemon drops, counts and
restarts. The rerun server listens on a random address of the loopback interface.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import socket
import sys
import uuid
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from groundstation.errors import BadInputError, TakenError
from groundstation.links.command import LinkEvent
from groundstation.rerun_log.channels import rerun_command, rerun_program
from groundstation.telemetry.decoder import LinkStatistics
from groundstation.telemetry.samples import LogTable, SampleBatch
from groundstation.viewer.child import Child, ViewerMode, free_port, listen_on
from groundstation.viewer.messages import (
    MAX_BYTES,
    MAX_ROWS,
    Message,
    decode_acknowledgement,
    encode_message,
    message_of,
)
from groundstation.viewer.relay import BEHIND

if TYPE_CHECKING:
    from groundstation.twin.twin import Shown

# What waits for the feeder: bounded, the oldest dropped first, every drop counted.


class Outbox:
    """Samples, and events, statistics or predictions ("notes"), until a socket takes them.

    sent, dropped: counts of samples plus notes. What was sent, but not taken by the reader before
    it died, was dropped.
    """

    def __init__(self, *, max_rows: int = 2000, max_notes: int = 200) -> None:
        self.sent = 0
        self.dropped = 0
        self._max_rows = max_rows
        self._batches: deque[SampleBatch] = deque()
        self._rows = 0
        self._notes: deque[Message] = deque()
        self._max_notes = max_notes
        self._untaken = 0
        self._taken = 0

    @property
    def waiting(self) -> int:
        """Samples and notes that nobody has taken yet."""
        return self._rows + len(self._notes)

    def put_samples(self, batch: SampleBatch) -> None:
        for start in range(0, len(batch), MAX_ROWS):
            piece = batch[start : start + MAX_ROWS] if len(batch) > MAX_ROWS else batch
            self._batches.append(piece)
            self._rows += len(piece)
            while self._rows > self._max_rows:
                oldest = self._batches.popleft()
                self._rows -= len(oldest)
                self.dropped += len(oldest)

    def put_note(self, note: Message) -> None:
        self._notes.append(note)
        if len(self._notes) > self._max_notes:
            self._notes.popleft()
            self.dropped += 1

    def flush(self, channel: socket.socket) -> None:
        """Send what the non-blocking ``channel`` takes now; the rest stays.

        Raises OSError when the other end is gone.
        """
        while self._batches:
            batches = self._next_run()
            batch = batches[0] if len(batches) == 1 else SampleBatch.concatenate(batches)
            if not _send(channel, encode_message(message_of(batch))):
                return
            for _ in batches:
                self._batches.popleft()
            self._rows -= len(batch)
            self._count(len(batch))
        while self._notes:
            data = encode_message(self._notes[0])
            if len(data) > MAX_BYTES:
                self.dropped += 1
            elif _send(channel, data):
                self._count(1)
            else:
                return
            self._notes.popleft()

    def new_reader(self) -> None:
        """Another reader: what the last one did not take is lost."""
        self.sent -= self._untaken
        self.dropped += self._untaken
        self._untaken = 0
        self._taken = 0

    def taken(self, total: int) -> None:
        """The reader has taken ``total`` samples and notes since it started."""
        self._untaken -= total - self._taken
        self._taken = total

    def _count(self, items: int) -> None:
        self.sent += items
        self._untaken += items

    def _next_run(self) -> list[SampleBatch]:
        """The oldest batches that fit one message: one source, at most ``MAX_ROWS`` rows."""
        first = self._batches[0]
        run, rows = [first], len(first)
        for batch in list(self._batches)[1:]:
            rows += len(batch)
            if rows > MAX_ROWS or batch.tick_s != first.tick_s:
                break
            run.append(batch)
        return run


def _send(channel: socket.socket, data: bytes) -> bool:
    try:
        channel.send(data)
    except BlockingIOError:
        return False
    return True


SEND_PERIOD_S = 0.08
"""Each message costs rerun about 15 kB whatever it holds: 12 a second look smooth."""
SLOW_SEND_PERIOD_S = 1.0
"""While a viewer is behind, or nobody looks: a twelfth of the messages, all rows. A browser without
a GPU takes in some 200 messages a second, however many rows each has."""
SLOW_FROM_S, SLOW_UNTIL_S = 2.0, 0.6
"""A viewer that is so far behind is sent less, until it is nearly up again."""
SILENCE_S = 3.0
START_S = 20.0
"""A feeder that has not been ready for so long is started again (importing rerun is slow)."""
BACK_OFF_S = (0.5, 1.0, 2.0, 4.0, 8.0)
SETTLED_S = 10.0
"""After so long without a failure the back-off starts anew."""
SERVER_MEMORY = "2MB"
"""What a viewer that opens late can still see, and has to take in before it is live: 15 s where
nobody looked before it, 8 s where somebody does."""
WINDOW_MEMORY = "2GB"

_SERVER_SILENT = 3  # feeder.SERVER_SILENT; importing that module would load rerun


class Viewer:
    """Shows samples, events and statistics; lossy by design.

    port, web_port: TCP ports on the loopback interface: rerun's own, and the web viewer's.
    twin: whether there will be predictions to show; tables: whether there will be further series.
    on_event: told (kind, text) about the viewer itself; kinds are ``viewer`` and ``fault``.
    """

    def __init__(
        self,
        mode: ViewerMode,
        *,
        port: int = 9876,
        web_port: int = 9090,
        twin: bool = False,
        tables: bool = False,
        on_event: Callable[[str, str], None] | None = None,
    ) -> None:
        self.mode = mode
        self.port = port
        self.web_port = web_port
        self._layout = (
            "+".join(name for name, shown in (("twin", twin), ("tables", tables)) if shown)
            or "plain"
        )
        self._on_event = on_event or (lambda kind, text: None)
        self._recording = f"live-{uuid.uuid4().hex[:12]}"
        self._outbox = Outbox()
        self._state = "off"
        self._restarts = 0
        self._failures = 0
        self._retry_at = 0.0
        self._heard_at = 0.0
        self._ready_at: float | None = None
        self._cut_viewers = False
        self._server: Child | None = None
        self._relay: Child | None = None
        self._relay_heard_at = 0.0
        self._viewers, self._behind_s = 0, 0.0
        self._is_thin, self._flushed_at = False, 0.0
        self._inner = ("", 0)  # the rerun server's address and port
        self._listening: list[socket.socket] = []
        self._feeder: Child | None = None
        self._window: Child | None = None
        self._wants_window = mode is ViewerMode.SPAWN
        self._channel: socket.socket | None = None
        self._dying: list[Child] = []
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Start serving in the background; ``status`` and ``on_event`` say when it is up.

        Raises TakenError when a port is taken, BadInputError when there is no display for a
        window or rerun is not installed, GroundStationError when its program is missing.
        """
        if self.mode is ViewerMode.OFF or self._task is not None:
            return
        rerun_program()
        if self._wants_window and not (os.environ.get("DISPLAY") or _wayland()):
            raise BadInputError(
                "no display to open a viewer window on (DISPLAY and WAYLAND_DISPLAY are not set): "
                "use --viewer serve and open the printed address in a browser"
            )
        try:
            for port, name in ((self.port, "viewer"), (self.web_port, "web viewer")):
                self._listening.append(listen_on(port, name))
        except TakenError:
            self._stop_listening()
            raise
        self._state = "starting"
        self._task = asyncio.create_task(self._supervise(), name="viewer")

    def samples(self, batch: SampleBatch) -> None:
        """Queue samples for the next message; never blocks."""
        if self._task is not None:
            self._outbox.put_samples(batch)

    def note(self, note: LinkEvent | LinkStatistics | LogTable | Shown) -> None:
        """A line of the event log, statistics and a craft's own log as plots, the twin's
        predictions beside what was measured; never blocks."""
        if self._task is not None:
            self._outbox.put_note(message_of(note))

    def split(self) -> None:
        """Each batch says which segment it is of."""

    def status(self) -> dict[str, Any]:
        """state: off, starting, serving, restarting or failed (still retried, but look at it)."""
        return {
            "state": self._state,
            "sent": self._outbox.sent,
            "dropped": self._outbox.dropped,
            "restarts": self._restarts,
            "viewers": self._viewers,
            "behind_s": self._behind_s,
            "urls": [] if self.mode is ViewerMode.OFF else self._urls(),
        }

    async def stop(self) -> None:
        """Hand over what is left and end every child: within a second or two, come what may."""
        if self._task is None:
            return
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self._task = None
        feeder = self._feeder
        if self._channel is not None:
            with contextlib.suppress(OSError):
                self._outbox.flush(self._channel)
        self._close_channel()
        if feeder is not None and self._ready_at is not None:
            await _until(lambda: feeder.poll() is not None, 0.8)
        self._drop("_feeder", "_window", "_relay", "_server")
        self._stop_listening()
        await _until(lambda: not self._reap(), 2.0)
        self._state = "off"

    # The supervisor: one pass every SEND_PERIOD_S.

    async def _supervise(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                self._step(loop.time())
            except Exception as error:  # whatever it is, the view is started again and says so
                self._fail(loop.time(), str(error) or repr(error), server=True)
            await asyncio.sleep(SEND_PERIOD_S)

    def _step(self, now: float) -> None:
        if self._reap():
            return  # its port may still be bound
        if self._feeder is None:
            if now >= self._retry_at:
                self._launch(now)
            return
        assert self._channel is not None
        if self._server is not None and self._server.poll() is not None:
            self._fail(now, f"the rerun server ended: {self._server.last_words}", server=True)
            return
        if self._relay is not None:
            if self._relay.poll() is not None:
                self._fail(now, f"the viewers' relay ended: {self._relay.last_words}", server=True)
                return
            for line in self._relay.new_lines():
                self._relay_heard_at = now
                if not self._is_alive(line):
                    self._on_event("viewer", line)
            if now - self._relay_heard_at > (START_S if self._ready_at is None else SILENCE_S):
                self._fail(now, f"the viewers' relay was silent for {SILENCE_S:g} s", server=True)
                return
        self._listen(now)
        status = self._feeder.poll()
        limit_s = START_S if self._ready_at is None else SILENCE_S
        if status is not None:
            silent = status == _SERVER_SILENT
            reason = self._feeder.last_words
            if reason == f"exit status {_SERVER_SILENT}":
                reason = "the rerun server does not answer"
            self._fail(now, f"the feed ended: {reason}", server=silent)
        elif now - self._heard_at > limit_s:
            # one that never began may be held up by the server
            never = self._ready_at is None
            self._fail(now, f"the feed has been stuck for {limit_s:g} s", server=never)
        else:
            if self._ready_at is not None:
                if now - self._ready_at > SETTLED_S:
                    self._failures = 0
                slow = self._is_thin or not self._viewers
                slow = slow and self._outbox.waiting < MAX_ROWS  # a full message costs no more
                if now - self._flushed_at >= (SLOW_SEND_PERIOD_S if slow else 0.0):
                    self._flushed_at = now
                    # a feeder that has just ended is seen next time
                    with contextlib.suppress(ConnectionError):
                        self._outbox.flush(self._channel)
            self._watch_window()

    def _is_alive(self, line: str) -> bool:
        """Whether a line of the relay's is a sign of life, which is taken over."""
        match line.split():
            case [word, viewers, behind_s] if word == BEHIND:
                self._viewers, self._behind_s = int(viewers), float(behind_s)
            case _:
                return False
        if self._behind_s > SLOW_FROM_S:
            self._is_thin = True
        elif self._behind_s < SLOW_UNTIL_S:
            self._is_thin = False
        return True

    def _launch(self, now: float) -> None:
        if self._server is None:
            address = f"127.{'.'.join(str(1 + secrets.randbelow(254)) for _ in range(3))}"
            port, web_port = free_port(address), free_port(address)
            self._inner = address, port
            options = (
                f"--serve-web --bind {address} --port {port} --web-viewer-port {web_port}"
                f" --server-memory-limit {SERVER_MEMORY}"
            )
            self._server = Child([str(rerun_program()), *options.split()])
            numbers = [one.fileno() for one in self._listening]
            relay = sys.executable, "-m", "groundstation.viewer.relay"
            words = map(str, (*numbers, address, port, web_port))
            self._relay = Child([*relay, *words], pass_fds=numbers)
            self._relay_heard_at = now
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        with theirs:
            self._channel = ours
            feeder = sys.executable, "-m", "groundstation.viewer.feeder"
            words = map(str, (theirs.fileno(), *self._inner, self._recording, self._layout))
            self._feeder = Child([*feeder, *words], pass_fds=[theirs.fileno()])
        self._heard_at, self._ready_at = now, None

    def _listen(self, now: float) -> None:
        assert self._channel is not None
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while said := self._channel.recv(64):
                self._heard_at = now
                self._outbox.taken(decode_acknowledgement(said).taken)
                if self._ready_at is None:
                    self._ready_at = now
                    self._state = "serving"
                    # rerun's viewers do not come back to a server by themselves (rerun 0.41)
                    hint = "; reload the viewers that were open" if self._cut_viewers else ""
                    self._cut_viewers = False
                    self._on_event("viewer", f"serving at {self._urls()[0]}{hint}")
                    self._open_window()

    def _fail(self, now: float, text: str, *, server: bool) -> None:
        wait_s = BACK_OFF_S[min(self._failures, len(BACK_OFF_S) - 1)]
        self._failures += 1
        self._restarts += 1
        self._state = "failed" if self._failures > len(BACK_OFF_S) else "restarting"
        self._retry_at = now + wait_s
        self._close_channel()
        self._outbox.new_reader()
        self._drop("_feeder")
        if server:
            self._viewers, self._behind_s, self._is_thin = 0, 0.0, False
            self._drop("_server", "_relay", "_window")
            self._cut_viewers = True
        self._on_event("fault", f"{text}; starting it again in {wait_s:g} s")

    def _open_window(self) -> None:
        if self._wants_window and self._window is None:
            options = (
                f"--connect {self._address()} --bind 127.0.0.1 --memory-limit {WINDOW_MEMORY}"
                " --hide-welcome-screen --expect-data-soon"
            )
            self._window = Child([str(rerun_program()), *options.split()])

    def _watch_window(self) -> None:
        if self._window is None:
            return
        status = self._window.poll()
        if status is None:
            return
        self._wants_window = False
        if status == 0:
            self._on_event("viewer", f"window closed; still serving at {self._urls()[0]}")
        else:
            self._on_event(
                "fault",
                f"the viewer window ended: {self._window.last_words}; "
                f"open {self._urls()[0]} in a browser instead",
            )
        self._window = None

    def _drop(self, *names: str) -> None:
        for name in names:
            child: Child | None = getattr(self, name)
            if child is not None:
                child.kill()
                self._dying.append(child)
                setattr(self, name, None)

    def _reap(self) -> bool:
        """Whether a killed child is still there."""
        self._dying = [child for child in self._dying if child.poll() is None]
        return bool(self._dying)

    def _stop_listening(self) -> None:
        while self._listening:
            self._listening.pop().close()

    def _close_channel(self) -> None:
        if self._channel is not None:
            self._channel.close()
            self._channel = None

    def _address(self) -> str:
        return f"rerun+http://127.0.0.1:{self.port}/proxy"

    def _urls(self) -> list[str]:
        """The browser's address, and the command for a rerun window."""
        web = f"http://127.0.0.1:{self.web_port}/?url={quote(self._address(), safe='')}"
        return [web, f"{rerun_command()} --connect {self._address()}"]


def _wayland() -> str | None:
    return os.environ.get("WAYLAND_DISPLAY") or os.environ.get("WAYLAND_SOCKET")


async def _until(condition: Callable[[], bool], timeout_s: float) -> None:
    deadline = asyncio.get_running_loop().time() + timeout_s
    while not condition() and asyncio.get_running_loop().time() < deadline:
        await asyncio.sleep(0.01)
