"""The daemon's side of the operator's page: a process of its own that is kept alive, and the
one-time tokens that let browsers in."""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import socket
import sys
from pathlib import Path
from typing import Any

from groundstation.errors import BadInputError, GroundStationError, NotAuthorisedError
from groundstation.service.config import PageConfig
from groundstation.viewer.child import Child, listen_on

KEY_BYTES = 32
KEY_VARIABLE = "GROUNDSTATION_PAGE_KEY"
LOOK_S = 0.2
START_S = 60.0
SILENCE_S = 15.0
"""A page's process that has given no sign of life for so long is ended and begun anew."""
TOKENS_MOST = 64
"""Addresses that nobody has opened yet; beyond it the oldest is void."""


class PageService:
    """Keeps the page's process alive; it serves on a port that the daemon holds, so that browsers
    find its successor at the same address.

    control: the control socket whose client the page is. Beside it lies the key that signs
    cookies, mode 0600: a browser that was let in stays so when the daemon is started anew.
    """

    def __init__(self, config: PageConfig, control: Path) -> None:
        self._config = config
        self._control = control
        self._key = ""
        self._tokens: list[str] = []
        self._listening: socket.socket | None = None
        self._child: Child | None = None
        self._serving = False
        self._restarts = 0

    def open(self) -> None:
        """Take the port, where a page is wanted. Raises TakenError where another program has it."""
        if self._config.enabled:
            self._listening = listen_on(self._config.port, "page")
            self._key = _key(self._control.with_suffix(".page"))

    async def keep(self) -> None:
        """Run the page's process; GroundStationError when it ends or stands still."""
        if self._listening is None:
            return
        await self._ended()
        loop = asyncio.get_running_loop()
        number = self._listening.fileno()
        child = self._child = Child(
            [sys.executable, "-m", "groundstation.page", str(number), str(self._control)],
            pass_fds=[number],
            environment={KEY_VARIABLE: self._key},
        )
        heard_s, self._serving = loop.time(), False
        while child.poll() is None:
            if child.new_lines():
                heard_s, self._serving = loop.time(), True
            limit_s = SILENCE_S if self._serving else START_S
            if loop.time() - heard_s > limit_s:
                child.kill()
                self._fail(f"the page's process was silent for {limit_s:g} s")
            await asyncio.sleep(LOOK_S)
        self._fail(f"the page's process ended: {child.last_words}")

    async def close(self) -> None:
        """End the process and give the port back. Safe to call twice."""
        self._serving = False
        await self._ended()
        if self._listening is not None:
            self._listening.close()
            self._listening = None

    def address(self) -> str:
        """A new address, which lets one browser in. Raises BadInputError where there is no page."""
        if self._listening is None:
            raise BadInputError(
                "the daemon serves no page; start it with 'groundstation run --page'"
            )
        token = secrets.token_urlsafe(24)
        self._tokens = [*self._tokens[-TOKENS_MOST + 1 :], token]
        return f"{self.url}/?token={token}"

    def admit(self, token: str) -> None:
        """Use up an address's token. Raises NotAuthorisedError for one that is not in force."""
        for known in self._tokens:
            if secrets.compare_digest(known.encode(), token.encode()):
                self._tokens.remove(known)
                return
        raise NotAuthorisedError(
            "this address has let a browser in already, or was never given out; "
            "'groundstation page' prints a new one"
        )

    def status(self) -> dict[str, Any]:
        """state: off, starting, serving or restarting."""
        if self._listening is None:
            return {"state": "off", "url": None, "restarts": self._restarts}
        waiting = "restarting" if self._restarts else "starting"
        state = "serving" if self._serving else waiting
        return {"state": state, "url": self.url, "restarts": self._restarts}

    @property
    def url(self) -> str:
        """Where it is served; it takes a token to get in."""
        return f"http://127.0.0.1:{self._config.port}"

    def _fail(self, text: str) -> None:
        self._serving = False
        self._restarts += 1
        raise GroundStationError(text)

    async def _ended(self) -> None:
        """Wait until a child that was there before is gone."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()
            while child.poll() is None:
                await asyncio.sleep(0.01)


def _key(path: Path) -> str:
    """The key of a daemon before this one, or a new one. Raises GroundStationError."""
    with contextlib.suppress(FileNotFoundError, ValueError):
        number = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        with open(number) as file:
            found, key = os.fstat(number), file.read(4 * KEY_BYTES).strip()
        ours = found.st_uid == os.getuid() and not found.st_mode & 0o077
        if ours and len(bytes.fromhex(key)) == KEY_BYTES:
            return key
    key = secrets.token_hex(KEY_BYTES)
    try:
        path.unlink(missing_ok=True)
        number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with open(number, "w") as file:
            file.write(key + "\n")
    except OSError as error:
        raise GroundStationError(f"the page's key {path}: {error.strerror}") from error
    return key
