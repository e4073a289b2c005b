"""What tests of the page share: requests to its application without a server, daemons that answer
from a table, and what a browser is expected to show."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from socketserver import ThreadingMixIn, UnixStreamServer
from typing import Any

from groundstation.page.app import Access

PORT = 9080
HOST = f"127.0.0.1:{PORT}"

Headers = list[tuple[bytes, bytes]]


def browser(access: Access) -> Headers:
    """Headers with which the page asks for a change in a browser that was let in."""
    session = access.new_session()
    return [
        (b"host", HOST.encode()), (b"origin", f"http://{HOST}".encode()),
        (b"cookie", f"{access.cookie}={session}".encode()),
        (b"x-change-token", access.change_token(session).encode()),
    ]  # fmt: skip


async def asked(
    app: Any, method: str, path: str, headers: Headers, body: Any = None
) -> tuple[int, bytes]:
    """Status and content of one answer."""
    said: list[Any] = []
    content = b"" if body is None else json.dumps(body).encode()

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": content, "more_body": False}

    async def send(message: Any) -> None:
        said.append(message)

    path, _, query = path.partition("?")
    scope = {
        **{"type": "http", "http_version": "1.1", "scheme": "http", "root_path": ""},
        "asgi": {"spec_version": "2.4"},  # nobody is asked whether the browser is still there
    }
    where = {"path": path, "raw_path": path.encode(), "query_string": query.encode()}
    await app({**scope, **where, "method": method, "headers": headers}, receive, send)
    return said[0]["status"], b"".join(one.get("body", b"") for one in said[1:])


def expect(locator: Any) -> Any:
    """Playwright's, with the patience of a busy machine."""
    from playwright.sync_api import expect as library

    library.set_options(timeout=120_000)
    return library(locator)


@contextmanager
def answering(path: Path, answers: dict[str, Any]) -> Iterator[list[str]]:
    """A control socket at ``path`` that answers "METHOD /route" from a table; what it is asked."""
    seen: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.rfile.read(int(self.headers.get("content-length", 0)))
            seen.append(f"{self.command} {self.path}")
            content = json.dumps(answers[seen[-1]]).encode()
            self.send_response(200)
            self.send_header("content-length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def do_POST(self) -> None:
            self.do_GET()

        def log_message(self, *_: object) -> None:
            pass

    class Server(ThreadingMixIn, UnixStreamServer):
        daemon_threads = True

    with Server(str(path), Handler) as server:
        serving = threading.Thread(target=server.serve_forever, args=(0.01,))
        serving.start()
        try:
            yield seen
        finally:
            server.shutdown()
            serving.join()
