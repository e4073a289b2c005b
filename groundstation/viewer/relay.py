"""``python -m groundstation.viewer.relay PORT_FD WEB_FD UPSTREAM UPSTREAM_PORT UPSTREAM_WEB_PORT``

Stands between viewers and the rerun server. Of rerun 0.41 one reader that lags by the server's
memory holds up everybody, and pages of any origin may read. The relay reads for everybody at
once, drops who does not take what waits for it, lets in programs of its own user (and root) only,
and a browser's page only where it came from this server. Each line on stderr is something to be
told, or a sign of life that says how far the slowest viewer is behind: ``behind VIEWERS SECONDS``.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import re
import socket
import sys
import time
from collections import deque
from collections.abc import Awaitable, Callable, Iterable
from pathlib import Path

# The web viewer's page as the relay hands it out: it says how old its newest row is.
#
# rerun 0.41 shows nothing of the kind, and asks other hosts for fonts, updates and statistics.
# Its page gets our script (``static/live.js``) and a policy under which the browser asks nobody
# else. The script tells here how far its viewer is behind: what a browser has read and not drawn
# yet nobody else knows.


STATIC = Path(__file__).with_name("static")
TOLD_S = 3.0
"""A viewer that has told nothing for so long is gone."""
ANSWER_S = 10.0
BODY_MOST = 64
TELLERS_MOST = 64
PAGE_MOST = 1 << 20
_PAGES = (b"/", b"/index.html")
_OUTSIDE = re.compile(rb"<link\b[^>]*https://[^>]*>")
_FILES = {b"/live.js": "text/javascript", b"/live.css": "text/css"}
_OURS = b'<link rel="stylesheet" href="live.css"><script src="live.js" defer></script></body>'


class WebPage:
    """What the relay answers itself. upstream: rerun's web server. live_port: of viewers."""

    def __init__(self, upstream: tuple[str, int], live_port: int) -> None:
        self._upstream = upstream
        hosts = " ".join(f"http://{host}:{live_port}" for host in ("127.0.0.1", "localhost"))
        self._policy = (
            "default-src 'self' 'unsafe-inline' blob: data:; base-uri 'none'; form-action 'none';"
            " script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:;"
            f" connect-src 'self' blob: data: {hosts}"
        )
        self._told: dict[bytes, tuple[float, float]] = {}  # viewer -> when, and how far behind

    @property
    def behind_s(self) -> float:
        """Age of the newest row in the slowest browser."""
        return max((behind_s for _, behind_s in self._recent().values()), default=0.0)

    async def answer(self, head: bytes, reader: asyncio.StreamReader, viewers: int) -> bytes | None:
        """The whole answer to an admitted request; None: rerun's server has it.

        viewers: live connections; a page without one is told so.
        """
        method, _, target = head.split(b"\r\n", 1)[0].partition(b" ")
        path, _, query = target.split(b" ")[0].partition(b"?")
        if method == b"POST" and path == b"/behind":
            return await self._heard(head, query, reader, viewers)
        if method != b"GET":
            return None
        if path in _FILES:
            return self._response((STATIC / path[1:].decode()).read_bytes(), _FILES[path])
        if path in _PAGES:
            async with asyncio.timeout(ANSWER_S):
                return await self._page()
        return None

    async def _heard(
        self, head: bytes, who: bytes, reader: asyncio.StreamReader, viewers: int
    ) -> bytes:
        length = re.search(rb"\r\ncontent-length: *(\d{1,2})\r\n", head, re.IGNORECASE)
        try:
            async with asyncio.timeout(ANSWER_S):
                body = await reader.readexactly(min(int(length[1]) if length else 0, BODY_MOST))
            behind_s = float(body)
        except ValueError:
            return self._response(b"", "text/plain", "400 Bad Request")
        full = who not in self._recent() and len(self._told) >= TELLERS_MOST
        if not math.isfinite(behind_s) or full:
            return self._response(b"", "text/plain", "400 Bad Request")
        self._told[who] = time.monotonic(), max(0.0, behind_s)
        connected = viewers >= len(self._recent())
        return self._response(json.dumps({"connected": connected}).encode(), "application/json")

    def _recent(self) -> dict[bytes, tuple[float, float]]:
        since = time.monotonic() - TOLD_S
        self._told = {who: told for who, told in self._told.items() if told[0] > since}
        return self._told

    async def _page(self) -> bytes:
        reader, writer = await asyncio.open_connection(*self._upstream)
        try:
            writer.write(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
            await reader.readuntil(b"\r\n\r\n")
            page = await reader.read(PAGE_MOST)
            while more := await reader.read(PAGE_MOST):
                page += more
        finally:
            writer.close()
        page = _OUTSIDE.sub(b"", page).replace(b"</body>", _OURS)
        return self._response(page, "text/html; charset=utf-8")

    def _response(self, body: bytes, kind: str, status: str = "200 OK") -> bytes:
        head = (
            f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
            f"Content-Security-Policy: {self._policy}\r\nX-Content-Type-Options: nosniff\r\n"
            "Referrer-Policy: no-referrer\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
        )
        return head.encode() + body


HEAD_S = 5.0
"""A request must have arrived after so long."""
HEAD_MOST = 1 << 14
STALL_S = 10.0
"""A client that takes nothing for so long although data wait is dropped. A browser that draws
without a GPU takes nothing for some seconds while it reads what was before it opened."""
WAITING_MOST = 192 << 20
"""Bytes that wait for all clients together: more than the server's memory, for one that opens
late; beyond it the slowest is dropped."""
CLIENTS_MOST = 32
TELL_S = 5.0
WATCH_S = 0.5
PIECE = 1 << 18
BEHIND = "behind"
_CONNECTIONS = Path("/proc/self/net/tcp")
"""The kernel's table: ends of each connection, its state, whose it is."""
_ESTABLISHED = "01"
PINGS_MOST = 8
"""Unanswered, one in each round of watching, after which a native viewer has stopped: HTTP/2 holds
its data back at the server, so that nothing waits here."""
_PING = b"\0\0\x08\x06\0\0\0\0\0relay up"
_FRAME_HEAD = 9
_HTTP2 = b"PRI * HTTP/2.0\r\n"
Answer = Callable[[bytes, asyncio.StreamReader], Awaitable[bytes | None]]
_HOSTS = ("127.0.0.1", "localhost", "[::1]")


class Relay:
    """One of rerun's two servers, relayed. allowed: origins of pages that may ask. answer: of
    requests that are not rerun's."""

    def __init__(
        self,
        port: int,
        upstream: tuple[str, int],
        allowed: Iterable[str],
        answer: Answer | None = None,
    ) -> None:
        self._hosts = {f"{host}:{port}".encode() for host in _HOSTS}
        self._allowed = {origin.encode() for origin in allowed}
        self._upstream = upstream
        self._answer = answer
        self.behind_s = 0.0
        """How old what the slowest viewer takes is: of the last round of watching."""
        self._clients: dict[asyncio.StreamWriter, _Progress] = {}
        self._told: dict[str, float] = {}

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Take care of one connection until either side ends it."""
        self._clients[writer] = _Progress()
        open_ends = {writer}  # an end that is closed must not be aborted: its transport is no more
        try:
            if len(self._clients) > CLIENTS_MOST:
                self._tell(f"a viewer was turned away: {CLIENTS_MOST} connections are open")
                return
            if (stranger := _stranger(writer)) is not None:
                self._tell(f"a program of {stranger} asked for the live view and was refused")
                return
            async with asyncio.timeout(HEAD_S):
                head = await self._admitted(reader, writer)
            if not head:
                return
            if self._answer is not None and (own := await self._answer(head, reader)) is not None:
                writer.write(own)
                await _close(writer, open_ends)
                return
            there, beyond = await asyncio.open_connection(*self._upstream)
            open_ends.add(beyond)
            beyond.write(head)
            if head == _HTTP2:
                self._clients[writer].frames = _Frames()
            up = asyncio.create_task(self._copy_up(reader, beyond, self._clients[writer]))
            down = asyncio.create_task(self._copy_down(there, writer))
            await asyncio.wait({up, down}, return_when=asyncio.FIRST_COMPLETED)
            for task in (up, down):
                task.cancel()
            await asyncio.gather(up, down, return_exceptions=True)
            await _close(writer, open_ends)  # what waits is still taken, or it is dropped
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # who leaves is no news
        finally:
            del self._clients[writer]
            for one in open_ends:
                one.transport.abort()

    async def watch(self) -> None:
        """Drop who stalls, for as long as the relay runs."""
        while True:
            await asyncio.sleep(WATCH_S)
            now_s = time.monotonic()
            waiting = {one: one.transport.get_write_buffer_size() for one in self._clients}
            held = _held_by_kernel() if self._clients else {}
            self.behind_s = max(
                (
                    # of a native viewer the server holds back what it does not read
                    max(
                        progress.behind_s(now_s, waiting[one] + _held(held, one)),
                        WATCH_S * progress.pings,
                    )
                    for one, progress in self._clients.items()
                ),
                default=0.0,
            )
            for client, progress in self._clients.items():
                if progress.stalled_s(now_s, waiting[client]) > STALL_S:
                    self._drop(client, f"it took nothing for {STALL_S:g} s")
                elif progress.pings >= PINGS_MOST:
                    self._drop(client, "it does not answer")
                elif progress.frames is not None and progress.frames.between:
                    client.write(_PING)
                    progress.pings += 1
                    progress.written += len(_PING)
            if sum(waiting.values()) > WAITING_MOST:
                self._drop(max(waiting, key=waiting.__getitem__), "it is too slow")

    @property
    def viewers(self) -> int:
        """Connections that something was sent to."""
        return sum(one.written > 0 for one in self._clients.values())

    async def _admitted(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> bytes | None:
        """The request's head as it is passed on; None for a refusal, which has been sent."""
        head = await reader.readuntil(b"\r\n")
        if head == _HTTP2:  # a native viewer: no browser begins like this
            return head
        while not head.endswith(b"\r\n\r\n"):
            head += await reader.readuntil(b"\r\n")
            if len(head) > HEAD_MOST:
                return None
        request, *lines = head[:-4].split(b"\r\n")
        fields = [
            (name.strip().lower(), value.strip())
            for name, _, value in (line.partition(b":") for line in lines)
        ]
        hosts = [value.lower() for name, value in fields if name == b"host"]
        origins = {value.lower() for name, value in fields if name == b"origin"}
        if len(hosts) != 1 or hosts[0] not in self._hosts or not origins <= self._allowed:
            stranger = b" ".join(origins or hosts).decode(errors="replace")
            self._tell(f"a page of {stranger[:100]} asked for the live view and was refused")
            writer.write(
                b"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
            )
            await writer.drain()
            return None
        # one request for each connection: the next one is looked at too
        kept = [
            line
            for line, (name, _) in zip(lines, fields, strict=True)
            if name not in (b"connection", b"keep-alive", b"upgrade")
        ]
        return b"\r\n".join([request, *kept, b"Connection: close", b"", b""])

    async def _copy_down(self, there: asyncio.StreamReader, client: asyncio.StreamWriter) -> None:
        while data := await there.read(PIECE):
            progress = self._clients[client]
            progress.written += len(data)
            if progress.frames is not None:
                progress.frames.feed(data)
            client.write(data)  # never waited for: that would hold up the server

    async def _copy_up(
        self, reader: asyncio.StreamReader, beyond: asyncio.StreamWriter, progress: _Progress
    ) -> None:
        with contextlib.suppress(ConnectionError):
            while data := await reader.read(PIECE):
                progress.pings = 0
                beyond.write(data)
                await beyond.drain()

    def _drop(self, client: asyncio.StreamWriter, why: str) -> None:
        client.transport.abort()
        self._tell(f"a viewer was dropped: {why}; reload it")

    def _tell(self, text: str) -> None:
        now_s = time.monotonic()
        if now_s - self._told.get(text, -TELL_S) >= TELL_S:
            self._told = {text: now_s, **dict(list(self._told.items())[:10])}
            print(text, file=sys.stderr, flush=True)


class _Frames:
    """Follows a server's HTTP/2 frames. between: a frame of ours may be put in now."""

    def __init__(self) -> None:
        self.between = False
        self._head = bytearray()
        self._left = 0  # bytes of the present frame still to come

    def feed(self, data: bytes) -> None:
        at = 0
        while at < len(data):
            if self._left:
                taken = min(self._left, len(data) - at)
                self._left -= taken
            else:
                taken = min(_FRAME_HEAD - len(self._head), len(data) - at)
                self._head += data[at : at + taken]
                if len(self._head) == _FRAME_HEAD:
                    self._left = int.from_bytes(self._head[:3], "big")
                    self._head.clear()
            at += taken
        self.between = not self._left and not self._head


async def _close(writer: asyncio.StreamWriter, open_ends: set[asyncio.StreamWriter]) -> None:
    writer.close()
    await writer.wait_closed()
    open_ends.remove(writer)


def _stranger(writer: asyncio.StreamWriter) -> str | None:
    """Who holds the other end of a connection within this machine, if not we or root.

    An end that is closed already has no owner any more, and nothing from it is wanted.
    """
    ours = _in_table(writer.get_extra_info("sockname"))
    theirs = _in_table(writer.get_extra_info("peername"))
    rows = _connections()
    if (ours, theirs) not in rows:
        return None  # a kernel that does not show its connections
    state, _, owner = rows.get((theirs, ours), ("", "", ""))
    if state != _ESTABLISHED:
        return "nobody that could be told"
    return None if int(owner) in (0, os.getuid()) else f"user {owner}"


def _connections() -> dict[tuple[str, str], tuple[str, str, str]]:
    """(one end, other end) -> state, queues, owner of each of this machine's connections."""
    rows = (line.split() for line in _CONNECTIONS.read_text().splitlines()[1:])
    return {(row[1], row[2]): (row[3], row[4], row[7]) for row in rows}


def _held_by_kernel() -> dict[tuple[str, str], tuple[int, int]]:
    """(one end, other end) -> bytes that were not acknowledged, and that nobody has read."""
    held = {}
    for ends, (_, queues, _) in _connections().items():
        sent, _, received = queues.partition(":")
        held[ends] = int(sent, 16), int(received, 16)
    return held


def _held(held: dict[tuple[str, str], tuple[int, int]], writer: asyncio.StreamWriter) -> int:
    """Bytes on their way between us and the other end's program, which is on this machine."""
    ends = [writer.get_extra_info(name) for name in ("sockname", "peername")]
    if None in ends:
        return 0
    ours, theirs = map(_in_table, ends)
    return held.get((ours, theirs), (0, 0))[0] + held.get((theirs, ours), (0, 0))[1]


def _in_table(address: tuple[str, int]) -> str:
    """As the kernel prints an IPv4 address: a number in the machine's own order, and the port."""
    number = int.from_bytes(socket.inet_aton(address[0]), sys.byteorder)
    return f"{number:08X}:{address[1]:04X}"


class _Progress:
    """written: bytes so far for one client, taken or not. frames: of a native viewer. pings: since
    anything was heard of it."""

    def __init__(self) -> None:
        self.written = 0
        self.frames: _Frames | None = None
        self.pings = 0
        self._taken = 0
        self._moved_s = self._looked_s = time.monotonic()
        self._marks: deque[tuple[float, int]] = deque()  # since when, and how much was written then

    def behind_s(self, now_s: float, waiting: int) -> float:
        """Age of the oldest byte that its program has not read, at most: it came after the look
        before the one that found it."""
        marks = self._marks
        if self.written > (marks[-1][1] if marks else 0):
            marks.append((self._looked_s, self.written))
        self._looked_s = now_s
        taken = self.written - waiting
        while len(marks) > 1 and marks[0][1] <= taken:
            marks.popleft()
        return now_s - marks[0][0] if marks and marks[0][1] > taken else 0.0

    def stalled_s(self, now_s: float, waiting: int) -> float:
        """How long nothing of what waits has been taken."""
        if not waiting or self.written - waiting != self._taken:
            self._taken, self._moved_s = self.written - waiting, now_s
        return now_s - self._moved_s


async def relay(live: socket.socket, web: socket.socket, upstream: str, *ports: int) -> None:
    """Relay what comes on the sockets ``live`` and ``web`` to the two ports of ``upstream``."""
    web_port = web.getsockname()[1]
    origins = [f"http://{host}:{web_port}" for host in _HOSTS]
    live_port = live.getsockname()[1]
    page = WebPage((upstream, ports[1]), live_port)
    viewers = Relay(live_port, (upstream, ports[0]), origins)

    async def answer(head: bytes, reader: asyncio.StreamReader) -> bytes | None:
        return await page.answer(head, reader, viewers.viewers)

    both = [(live, viewers), (web, Relay(web_port, (upstream, ports[1]), origins, answer))]
    servers = [await asyncio.start_server(one.serve, sock=listening) for listening, one in both]
    await asyncio.gather(
        _beat(viewers, page),
        *(server.serve_forever() for server in servers),
        *(one.watch() for _, one in both),
    )


async def _beat(live: Relay, page: WebPage) -> None:
    """A line each half second: alive, and how far viewers are behind."""
    while True:
        behind_s = max(live.behind_s, page.behind_s)
        print(BEHIND, live.viewers, f"{behind_s:.1f}", file=sys.stderr, flush=True)
        await asyncio.sleep(WATCH_S)


if __name__ == "__main__":
    first, second, address, *numbers = sys.argv[1:]
    asyncio.run(
        relay(
            socket.socket(fileno=int(first)),
            socket.socket(fileno=int(second)),
            address,
            *map(int, numbers),
        )
    )
