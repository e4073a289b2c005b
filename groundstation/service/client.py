"""Talking to a running daemon, with patience that ends."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import struct
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Self

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from groundstation.errors import GroundStationError
from groundstation.service.config import shared_folder

if TYPE_CHECKING:
    from http.client import HTTPConnection

# Talking to a running daemon.


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

    client: a name for people. stops: ``command.stops`` of the status when a person began this
    program, None: whatever it is; entering fails where the operator has stopped the motors since.
    lease: token, ``stops``, the failsafe's limits (``lease_s``, ``level_s``, ``stop_s``), the
    command link's ``uri`` and ``state``, and which ``craft`` it is.

    Leaving lands a craft that still flies, or stops its motors where it holds no height. A process
    that dies instead leaves it to the failsafe.

    content: whether what it wrote is meant to stay. It is not where an exception leaves: the daemon
    writes the former values back then.
    wrote: whether something was written that is not put back. Where the craft cannot be given back
    then, the daemon writes the former values back: leaving raises GroundStationError.
    """

    def __init__(self, path: Path, client: str, stops: int | None = None) -> None:
        super().__init__(path)
        self._client, self._stops = client, stops
        self.lease: dict[str, Any] = {}
        self.content = True
        self.wrote = False

    def __enter__(self) -> Self:
        try:
            wanted = {"client": self._client, "stops": self._stops}
            self.lease = self.ask("POST", "/command/acquire", wanted)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        stays = self.content and error[0] is None
        try:
            self.release(content=stays)
        except GroundStationError as lost:  # the lease is over, or the daemon is
            if self.wrote and stays:
                raise GroundStationError(
                    f"what was written to the craft does not stay: {lost}. The daemon writes the"
                    " former values back, once it runs and the craft stands"
                ) from lost
        finally:
            self.close()

    def setpoint(
        self,
        roll_deg: float,
        pitch_deg: float,
        yaw_dps: float,
        thrust: int = 0,
        *,
        height_m: float | None = None,
        vx_m_s: float | None = None,
        vy_m_s: float | None = None,
    ) -> dict[str, Any]:
        """Send one setpoint: ``time_ns``, the newest ``telemetry``, ``place`` and ``link_state``.

        Signs are those of the telemetry: roll left side up, pitch nose down, yaw rate
        counter-clockwise. At most 100 a second; thrust 0..60000, or a height in its place, and with
        it a velocity forward and left in the place of roll and pitch.
        """
        values = {"roll_deg": roll_deg, "pitch_deg": pitch_deg, "yaw_dps": yaw_dps}
        values["made_s"] = time.monotonic()  # it grows old, whoever is held up
        more = {"height_m": height_m, "vx_m_s": vx_m_s, "vy_m_s": vy_m_s}
        values |= {name: value for name, value in more.items() if value is not None}
        answer: dict[str, Any] = self._command("setpoint", **values, thrust=thrust)
        return answer

    def parameters(self) -> dict[str, float]:
        """Every parameter of the craft by full name."""
        values: dict[str, float] = self.ask("GET", "/command/parameters")["values"]
        return values

    def write(self, values: dict[str, float]) -> dict[str, float]:
        """Write parameters, all or none where one is refused; what the craft read back."""
        self.wrote = True
        back: dict[str, float] = self._command("parameters", values=values)["values"]
        return back

    def stored(self) -> dict[str, Any]:
        """What the craft can keep while it is switched off, by full name: ``now``, ``default``, and
        ``stored``, None where nothing is."""
        found: dict[str, Any] = self.ask("GET", "/command/stored")["parameters"]
        return found

    def store(self, *names: str) -> dict[str, Any]:
        """Store present values on a craft that stands, no names: every gain that it would lose;
        what it then has, as ``stored``."""
        return dict(self._command("stored/store", names=names)["parameters"])

    def clear_stored(self, *names: str) -> dict[str, Any]:
        """Clear stored values, no names: every gain; what it then has, as ``stored``. The craft
        flies with what it has until it is switched off."""
        return dict(self._command("stored/clear", names=names)["parameters"])

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

    def land(self) -> str:
        """Have the daemon land the craft, which takes 6 s at most, and keep the lease: ``landed``,
        or what is known of the motors where it could not be landed."""
        told: str = self._command("land_own")["motors"]
        return told

    def announce(self, text: str, in_s: float) -> None:
        """Say to the people near the craft what is about to happen to it, and in how many s."""
        self._command("announce", text=text, in_s=in_s)

    def release(self, *, content: bool = True) -> None:
        """Give the craft back; one that still flies is landed. Parameters that were written stay,
        or the daemon writes the former values back where the client is not content."""
        self._command("release", content=content)

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


# HTTP without endless patience: for a place, for a request, or for a reader.


REQUEST_S = 10.0
"""A request must have arrived after so long."""
HEAD_MOST = 1 << 14
QUEUE = 2048
"""Connections that wait in the kernel."""
STALL_S = 20.0
"""A client that takes nothing of an answer for so long is cut off."""

_FULL = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"

Headers = Iterable[tuple[bytes, bytes]]


def http_server(
    app: ASGIApp,
    most: int,
    knows: Callable[[Headers], bool] = lambda headers: True,
    turned_away: Callable[[], None] = lambda: None,
) -> uvicorn.Server:
    """A server with ``most`` places. knows: whether a request's headers are those of somebody who
    was let in: who has shown nothing makes room for another, so that nobody can sit on every place.
    turned_away: told of each connection that came to a full house."""
    settings = {
        "most": most,
        "knows": staticmethod(knows),
        "turned_away": staticmethod(turned_away),
    }
    return _Server(
        uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            lifespan="off",
            http=type("_Patient", (_Protocol,), settings),
            ws="none",
            h11_max_incomplete_event_size=HEAD_MOST,
            server_header=False,
            timeout_graceful_shutdown=1,
            # so many are let in at each turn of the event loop, which reads what they said two
            # turns later: fewer come until then than can push out one whose request is there
            backlog=most // 4,
        )
    )


class _Server(uvicorn.Server):
    """Leaves signals to the program; lets in few connections at a time of many that wait."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for one in sockets or ():
            one.listen(QUEUE)

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self.should_exit = True


class _Protocol(H11Protocol):
    most: int
    knows: Callable[[Headers], bool]
    turned_away: Callable[[], None]
    _since_s = 0.0
    _arriving: asyncio.TimerHandle | None = None
    _stalled: asyncio.TimerHandle | None = None

    # the server opens streams only: a narrower type than any transport's
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._since_s = self.loop.time()
        if len(self.connections) > self.most:
            self.turned_away()
            others: list[Any] = [one for one in self.connections if one is not self]
            strangers = [one for one in others if _is_stranger(one)]
            if not strangers:
                transport.write(_FULL)
                transport.close()
                return
            min(strangers, key=lambda one: one._since_s).transport.abort()
        self._arriving = self.loop.call_later(REQUEST_S, transport.abort)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            _cancel(self._arriving)
            self._arriving = None
        elif self._arriving is None:
            self._arriving = self.loop.call_later(REQUEST_S, self.transport.abort)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._stalled = self.loop.call_later(STALL_S, self.transport.abort)

    def resume_writing(self) -> None:
        super().resume_writing()
        _cancel(self._stalled)

    def connection_lost(self, exc: Exception | None) -> None:
        _cancel(self._arriving)
        _cancel(self._stalled)
        super().connection_lost(exc)


def _is_stranger(one: Any) -> bool:
    """Without a whole request so far, or one that was not let in with its last."""
    if one.transport.is_closing():
        return False
    return one.headers is None or not one.knows(one.headers)


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
