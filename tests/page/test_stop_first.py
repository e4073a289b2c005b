"""What ends the turning of motors waits for no other request, whatever the daemon is slow at."""

import asyncio
import re

import pytest

from groundstation.page.app import Access, page_app
from support.page_requests import HOST, PORT, asked, browser
from support.waiting import eventually

OTHERS = 20
STOPS = (("stop", None), ("level", {"on": True}), ("arm", {"on": False}))
LAND = ("land", None)


@pytest.mark.parametrize(
    ("at_once", "waits"), [(STOPS, [LAND]), ([LAND], [])], ids=["stop", "land"]
)
def test_it_is_answered_while_all_else_that_was_asked_for_waits(tmp_path, at_once, waits):
    access = Access(b"key", PORT)
    headers, stranger = browser(access), [(b"host", HOST.encode())]
    waiting = []

    async def daemon(reader, writer):
        """Answers what is asked for at once, and nothing else."""
        head = await reader.readuntil(b"\r\n\r\n")
        length = re.search(rb"content-length: (\d+)", head.lower())
        await reader.readexactly(int(length[1]) if length else 0)  # left unread it were a reset
        if any(f"/command/{what} ".encode() in head for what, _ in at_once):
            writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}")
            await writer.drain()
        else:
            waiting.append(writer)
            await reader.read()
        writer.close()

    async def session_of_a_page():
        control = tmp_path / "control.sock"
        server = await asyncio.start_unix_server(daemon, control)
        app = page_app(control, access, None)
        others = [
            asyncio.ensure_future(asked(app, method, path, who, body))
            for _ in range(OTHERS)
            for method, path, who, body in (
                ("GET", "/file/log/fit", headers, None),
                ("GET", "/devices", headers, None),
                ("GET", "/?token=x", stranger, None),
                ("POST", "/do/link", headers, {"name": "stand-in"}),
                *(("POST", f"/do/command/{what}", headers, body) for what, body in waits),
            )
        ]
        await eventually(lambda: len(waiting) >= 6, "the daemon is asked")
        answers = [
            await asyncio.wait_for(asked(app, "POST", f"/do/command/{what}", headers, body), 60)
            for what, body in at_once
        ]
        assert not any(other.done() for other in others)
        server.close()
        while not all(other.done() for other in others):
            while waiting:
                waiting.pop().transport.abort()
            await asyncio.sleep(0.01)
        await asyncio.gather(*others, return_exceptions=True)
        return answers

    assert asyncio.run(session_of_a_page()) == [(200, b"{}")] * len(at_once)
