"""The web viewer's page as the relay hands it out: it says how old its newest row is.

rerun 0.41 shows nothing of the kind, and asks other hosts for fonts, updates and statistics. Its
page gets our script (``static/live.js``) and a policy under which the browser asks nobody else.
The script tells here how far its viewer is behind: what a browser has read and not drawn yet nobody
else knows.
"""

from __future__ import annotations

import asyncio
import json
import math
import re
import time
from pathlib import Path

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
