"""Talking to a running daemon."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
import time
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from groundstation.errors import GroundStationError
from groundstation.service.config import shared_folder

if TYPE_CHECKING:
    from http.client import HTTPConnection

TIMEOUT_S = 45.0
"""Finishing a recording on a bad disk is given 30 s."""
IDLE_S = 3.0
"""The daemon closes a connection that has been idle for 5 s: one this old is opened anew."""


def _connection_to(path: Path) -> HTTPConnection:
    from http.client import HTTPConnection  # here: every command would wait for its import

    class UnixConnection(HTTPConnection):
        def connect(self) -> None:
            self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            self.sock.settimeout(TIMEOUT_S)
            try:
                self.sock.connect(str(path))
                _require_ours(self.sock, path)
            except (OSError, GroundStationError):
                self.sock.close()
                raise

    return UnixConnection("localhost", timeout=TIMEOUT_S)


def _require_ours(connection: socket.socket, path: Path) -> None:
    """Whoever makes a socket first in a folder for all could tell anything: only one's own daemon,
    or root's, is believed; root may ask another's where the path was chosen."""
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _, user, _ = _CREDENTIALS.unpack(credentials)
    chosen = os.getuid() == 0 and path.parent != shared_folder()
    if user not in (os.getuid(), 0) and not chosen:
        raise GroundStationError(
            f"control socket {path}: belongs to user {user}, not to you; nothing was asked. Set "
            "GROUNDSTATION_SOCKET, or remove what is there"
        )


_CREDENTIALS = struct.Struct("iII")
"""Process, user and group of the other side, see unix(7)."""


class Client:
    """A connection to the daemon at ``path`` that is kept between requests."""

    def __init__(self, path: str | Path) -> None:
        self._path = path = Path(path)
        self._connection = _connection_to(path)
        self._used_s = 0.0

    def ask(self, method: str, route: str, body: dict[str, Any] | None = None) -> Any:
        """One request; its answer decoded from JSON.

        Raises GroundStationError when no daemon answers, or with the daemon's own refusal.
        """
        content = None if body is None else json.dumps(body)
        headers = {} if body is None else {"Content-Type": "application/json"}
        if time.monotonic() - self._used_s > IDLE_S:
            self._connection.close()
        self._used_s = time.monotonic()
        with _explained(self._path):
            try:
                self._connection.request(method, route, content, headers)
                # closed here: what its finaliser raises, Ctrl-C too, Python would drop silently
                with self._connection.getresponse() as response:
                    answer = response.read()
                if response.status == 200:
                    return json.loads(answer)
            except BaseException:
                self._connection.close()
                raise
        status = f"{response.status} {response.reason}"
        raise GroundStationError(
            _refusal(answer)
            or f"the daemon at {self._path} answered {method} {route} with {status}"
        )

    def close(self) -> None:
        """Safe to call twice."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def ask(path: Path, method: str, route: str, body: dict[str, Any] | None = None) -> Any:
    """One request to the daemon at ``path``, as ``Client.ask``."""
    with Client(path) as client:
        return client.ask(method, route, body)


class Pilot(Client):
    """The one client that commands, from entering the context until leaving it.

    client: a name for people. lease: token, the failsafe's limits (``lease_s``, ``level_s``,
    ``stop_s``), and the command link's ``uri`` and ``state``.

    Leaving stops motors that still run. A process that dies instead leaves it to the failsafe.
    """

    def __init__(self, path: Path, client: str) -> None:
        super().__init__(path)
        self._client = client
        self.lease: dict[str, Any] = {}

    def __enter__(self) -> Self:
        try:
            self.lease = self.ask("POST", "/command/acquire", {"client": self._client})
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        with contextlib.suppress(GroundStationError):  # the lease may be over already
            self.release()
        self.close()

    def setpoint(
        self,
        roll_deg: float,
        pitch_deg: float,
        yaw_dps: float,
        thrust: int = 0,
        *,
        height_m: float | None = None,
    ) -> dict[str, Any]:
        """Send one setpoint: ``time_ns``, the newest ``telemetry`` and ``link_state``.

        Signs are those of the telemetry: roll left side up, pitch nose down, yaw rate
        counter-clockwise. At most 100 a second; thrust 0..60000, or a height in its place.
        """
        values = {"roll_deg": roll_deg, "pitch_deg": pitch_deg, "yaw_dps": yaw_dps}
        values["made_s"] = time.monotonic()  # it grows old, whoever is held up
        at_height = {} if height_m is None else {"height_m": height_m}
        answer: dict[str, Any] = self._command("setpoint", **values, thrust=thrust, **at_height)
        return answer

    def parameters(self) -> dict[str, float]:
        """Every parameter of the craft by full name."""
        values: dict[str, float] = self.ask("GET", "/command/parameters")["values"]
        return values

    def write(self, values: dict[str, float]) -> dict[str, float]:
        """Write parameters, all or none where one is refused; what the craft read back."""
        back: dict[str, float] = self._command("parameters", values=values)["values"]
        return back

    def keep(self) -> None:
        """Keep the lease while nothing is sent."""
        self._command("keep")

    def mark(self, text: str, **details: Any) -> None:
        """Put a note into the recording, among its events."""
        self.ask("POST", "/record/mark", {"text": text, "details": details})

    def stop(self) -> str:
        """Stop the motors and keep the lease; what the craft then says of them within 2.5 s:
        ``stopped`` where they stand."""
        told: str = self._command("stop_own")["motors"]
        return told

    def release(self) -> None:
        """Stop the motors and give the craft back."""
        self._command("release")

    def _command(self, what: str, **content: Any) -> Any:
        token = self.lease["token"]
        return self.ask("POST", f"/command/{what}", {"token": token, **content})


def live(
    path: str | Path, rows_hz: float | None = None
) -> Generator[tuple[str, dict[str, Any]], None, None]:
    """What the daemon at ``path`` streams, as (kind, content); kinds are samples, event and
    statistics. rows_hz: about so many rows a second, some together; None: all, as they come. Ends
    with the daemon; raises GroundStationError when there is none."""
    path = Path(path)
    connection = _connection_to(path)
    with _explained(path), contextlib.closing(connection):
        connection.request("GET", "/stream" + ("" if rows_hz is None else f"?rows_hz={rows_hz:g}"))
        with contextlib.closing(connection.getresponse()) as response:
            if response.status != 200:
                raise GroundStationError(_refusal(response.read()) or f"{path}: {response.reason}")
            kind = ""
            for line in response:
                name, _, content = line.decode().rstrip("\n").partition(": ")
                if name == "event":
                    kind = content
                elif name == "data":
                    yield kind, json.loads(content)


@contextlib.contextmanager
def _explained(path: Path) -> Iterator[None]:
    """What can go wrong with the daemon at ``path``, in words."""
    from http.client import HTTPException

    try:
        yield
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
    except (OSError, HTTPException, ValueError) as error:
        raise GroundStationError(f"control socket {path}: {error}") from error


def _refusal(body: bytes) -> str | None:
    """The daemon's own words, where it refused on purpose."""
    try:
        return str(json.loads(body)["error"])
    except (ValueError, LookupError, TypeError):
        return None
