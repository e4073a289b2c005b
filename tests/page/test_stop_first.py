"""Stop, level and disarm wait for no other request of the page, whatever the daemon is slow at."""

import asyncio
import json
import re

from groundstation.page.access import Access
from groundstation.page.app import page_app
from support.waiting import eventually

PORT = 9080
HOST = f"127.0.0.1:{PORT}"
OTHERS = 20
AT_ONCE = (("stop", None), ("level", {"on": True}), ("arm", {"on": False}))


async def asked(app, method, path, headers, body=None):
    """The status of one answer."""
    said = []
    content = b"" if body is None else json.dumps(body).encode()

    async def receive():
        return {"type": "http.request", "body": content, "more_body": False}

    async def send(message):
        said.append(message)

    path, _, query = path.partition("?")
    scope = {"type": "http", "http_version": "1.1", "scheme": "http", "root_path": ""}
    where = {"path": path, "raw_path": path.encode(), "query_string": query.encode()}
    await app({**scope, **where, "method": method, "headers": headers}, receive, send)
    return said[0]["status"]


def test_a_stop_is_answered_while_all_else_that_was_asked_for_waits(tmp_path):
    access = Access(b"key", PORT)
    session = access.new_session()
    headers = [
        (b"host", HOST.encode()), (b"origin", f"http://{HOST}".encode()),
        (b"cookie", f"{access.cookie}={session}".encode()),
        (b"x-change-token", access.change_token(session).encode()),
    ]  # fmt: skip
    stranger = [(b"host", HOST.encode())]
    waiting = []

    async def daemon(reader, writer):
        """Answers what ends the turning of motors, and nothing else."""
        head = await reader.readuntil(b"\r\n\r\n")
        length = re.search(rb"content-length: (\d+)", head.lower())
        await reader.readexactly(int(length[1]) if length else 0)  # left unread it were a reset
        if any(f"/command/{what} ".encode() in head for what, _ in AT_ONCE):
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
            )
        ]
        await eventually(lambda: len(waiting) >= 6, "the daemon is asked")
        answers = [
            await asyncio.wait_for(asked(app, "POST", f"/do/command/{what}", headers, body), 60)
            for what, body in AT_ONCE
        ]
        assert not any(other.done() for other in others)
        server.close()
        while not all(other.done() for other in others):
            while waiting:
                waiting.pop().transport.abort()
            await asyncio.sleep(0.01)
        await asyncio.gather(*others, return_exceptions=True)
        return answers

    assert asyncio.run(session_of_a_page()) == [200] * 3
