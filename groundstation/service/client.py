"""Talking to a running daemon."""

from __future__ import annotations

import http.client
import json
import socket
from pathlib import Path
from typing import Any

from groundstation.errors import GroundStationError

TIMEOUT_S = 45.0
"""Finishing a recording on a bad disk is given 30 s."""


class _UnixConnection(http.client.HTTPConnection):
    def __init__(self, path: Path) -> None:
        super().__init__("localhost", timeout=TIMEOUT_S)
        self._path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(TIMEOUT_S)
        self.sock.connect(str(self._path))


def ask(path: Path, method: str, route: str) -> Any:
    """One request to the daemon at ``path``; its answer decoded from JSON.

    Raises GroundStationError when no daemon answers there, or with the daemon's own refusal.
    """
    connection = _UnixConnection(path)
    try:
        connection.request(method, route)
        response = connection.getresponse()
        body = response.read()
        if response.status == 200:
            return json.loads(body)
    except (FileNotFoundError, ConnectionRefusedError) as error:
        raise GroundStationError(
            f"no groundstation is running (nothing answers at {path}); start one with "
            "'groundstation run'"
        ) from error
    except TimeoutError as error:
        raise GroundStationError(
            f"the groundstation at {path} has not answered for {TIMEOUT_S:g} s: it is stopped or "
            "stuck; look at its terminal, or end it and start it again"
        ) from error
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise GroundStationError(f"control socket {path}: {error}") from error
    finally:
        connection.close()
    answer = f"{response.status} {response.reason}"
    raise GroundStationError(
        _refusal(body) or f"the daemon at {path} answered {method} {route} with {answer}"
    )


def _refusal(body: bytes) -> str | None:
    """The daemon's own words, where it refused on purpose."""
    try:
        return str(json.loads(body)["error"])
    except (ValueError, LookupError, TypeError):
        return None
