"""The daemon's configuration, its control socket, and what it tells systemd."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import os
import socket
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import msgspec

from groundstation.documents import decode_toml, explained, read_document
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError, GroundStationError, TakenError
from groundstation.links.factory import KINDS, STAND_IN
from groundstation.text import printable

# The daemon's configuration: one TOML file, typed; environment and command line override it.


MEBIBYTE = 1 << 20
DEFAULT_VEHICLE = "crazyflie1"
"""Of links whose craft does not say what it is: the thesis's."""
ENVIRONMENT = "GROUNDSTATION_"
"""``recording.folder`` is ``GROUNDSTATION_RECORDING_FOLDER`` in the environment."""


def _key(text: str, **limits: Any) -> Any:
    return msgspec.Meta(description=text, **limits)


class LinkConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where telemetry comes from."""

    name: Annotated[
        str,
        _key(KINDS, min_length=1),
    ] = STAND_IN
    speed: Annotated[
        float | Literal["max"], _key('of stand-in and replay: 1 is real time, or "max"')
    ] = 1.0


class UsbConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The bridge on USB."""

    device: Annotated[str, _key("VID:PID, hexadecimal")] = "0483:5741"
    serial: Annotated[str, _key("serial number, empty for any")] = ""


class RadioConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A craft that is asked for its log: radio://, usb:// or udp://."""

    rate_hz: Annotated[
        int,
        _key(
            "rows a second: 1000, 500, 250, 200, 125, 100 or 50; 0: as many as the link bears, 250"
            " at most"
        ),
    ] = 0
    log: Annotated[str, _key("further log variables, GROUP.NAME,...; empty: none")] = ""


class RecordingConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is kept, and where."""

    folder: Annotated[str, _key("where recordings go", min_length=1)] = "sessions"
    enabled: Annotated[bool, _key("record from the start")] = True
    low_space_mb: Annotated[
        float,
        _key("finish the recording when less is free, MiB; resume at twice that", ge=0, le=1e9),
    ] = 64.0
    rotate_mb: Annotated[
        float, _key("begin a new file at this size, MiB; 0: never", ge=0, le=1e9)
    ] = 1024.0
    rotate_minutes: Annotated[
        float, _key("begin a new file after this time; 0: never", ge=0, le=1e6)
    ] = 60.0
    keep_mb: Annotated[
        float,
        _key("delete the oldest recordings beyond this, MiB; 0: never delete", ge=0, le=1e9),
    ] = 0.0


class ViewerConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The live view."""

    mode: Annotated[
        Literal["off", "serve", "spawn"], _key("off, serve (browser) or spawn (window)")
    ] = "off"
    port: Annotated[int, _key("rerun's own TCP port, on loopback", ge=1, le=65535)] = 9876
    web_port: Annotated[int, _key("the browser's TCP port, on loopback", ge=1, le=65535)] = 9090


class PageConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The operator's page."""

    enabled: Annotated[bool, _key("serve the operator's page")] = False
    port: Annotated[int, _key("the page's TCP port, on loopback", ge=1, le=65535)] = 9080


class TwinConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The model that flies beside the craft."""

    model: Annotated[str, _key("model file the live twin flies; empty: no twin")] = ""


class ControlConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How other programs reach the daemon."""

    socket: Annotated[
        str, _key("path of the control socket; empty: in the user's runtime folder")
    ] = ""


class LogConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is written to stderr."""

    format: Annotated[Literal["text", "json"], _key("text, or json: one object a line")] = "text"


class FailsafeConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What happens when a client that commands falls silent."""

    level_s: Annotated[
        float, _key("without a setpoint while motors run: level attitude, s", ge=0.05, le=0.5)
    ] = 0.2
    stop_s: Annotated[
        float,
        _key(
            "without a setpoint: a landing, or motors off where the craft holds no height; the"
            " lease is over, s",
            ge=0.1,
            le=1.6,
        ),
    ] = 0.6
    lease_s: Annotated[
        float, _key("without any request, motors off: the lease is over, s", ge=1.0, le=60.0)
    ] = 5.0


class Config(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Everything the daemon can be told."""

    command: Annotated[
        str,
        _key(
            "command link: udp://HOST:PORT (stand-in), radio://... (craft); empty: that of a"
            " craft's own telemetry, else none"
        ),
    ] = ""
    vehicle: Annotated[
        str, _key("profile named in recordings; empty: what the craft says, else crazyflie1")
    ] = ""
    link: LinkConfig = LinkConfig()
    usb: UsbConfig = UsbConfig()
    radio: RadioConfig = RadioConfig()
    recording: RecordingConfig = RecordingConfig()
    viewer: ViewerConfig = ViewerConfig()
    page: PageConfig = PageConfig()
    twin: TwinConfig = TwinConfig()
    control: ControlConfig = ControlConfig()
    log: LogConfig = LogConfig()
    failsafe: FailsafeConfig = FailsafeConfig()
    stand_in: Annotated[
        dict[str, Any], _key("settings of the software craft, see docs/stand_in.md")
    ] = {}


FORMER = {
    "control.tcp_port": "the control API is on its Unix socket alone; from another machine, or by a"
    " port, 'ssh -N -L PORT:SOCKET HOST' leads to it",
    "recording.ros2_hz": "'groundstation convert FILE bag.mcap --ros2 500' makes a bag of it",
    "stand_in.attitude": "a fitted model is flown by its body; 'compare' and 'simulate --recording'"
    " show how its ARX polynomials follow a flight",
}
"""Keys of earlier versions, and what does their work now."""

RENAMED = {"dead_man": "failsafe"}
"""Tables of 1.0 -> their names of today. Until 2.0 the old one is read, with a warning."""


@dataclass(frozen=True, slots=True)
class Setting:
    """One key: ``table.key``, or ``key`` at the top."""

    name: str
    value: Any
    default: Any
    text: str


@dataclass(frozen=True, slots=True)
class ConfigSource:
    """Where a configuration comes from; what comes later wins.

    path: TOML file, None for none. changes: ``table.key`` -> value, of the command line.
    """

    path: Path | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))

    def load(self) -> Config:
        """Raises BadInputError that names the place and the key of what is wrong."""
        config = load_config(self.path)
        for name, value in self._from_environment():
            config = _changed(config, {name: value}, ENVIRONMENT + _variable(name), strict=False)
        config = _changed(config, self.changes, "command line", strict=True)
        require_sense(config)
        return config

    def _from_environment(self) -> Iterator[tuple[str, str]]:
        for name in FORMER:
            if ENVIRONMENT + _variable(name) in self.environment:
                raise BadInputError(f"{ENVIRONMENT}{_variable(name)}: {former(name)}")
        for name in keys():
            table, dot, key = name.partition(".")
            earlier = [f"{old}.{key}" for old, today in RENAMED.items() if dot and today == table]
            for one in (*earlier, name):
                value = self.environment.get(ENVIRONMENT + _variable(one))
                if value is not None:
                    yield todays_name(one, f"{ENVIRONMENT}{_variable(one)}: "), value


def load_config(path: Path | None) -> Config:
    """Read the file, or the defaults when there is none. Errors name the key."""
    if path is None:
        return Config()
    where = f"configuration {path}: "
    try:
        tables = decode_toml(read_document(path), dict[str, Any])
        for name in RENAMED.keys() & tables.keys():
            if RENAMED[name] in tables:
                raise ValueError(f"{name} is {RENAMED[name]} now, and both are given: keep one")
            tables[todays_name(name, where)] = tables.pop(name)
        return msgspec.convert(tables, Config)
    except OSError as error:
        raise BadInputError(f"{where}{error.strerror or error}") from error
    except msgspec.ValidationError as error:
        said = next((former(name) for name in FORMER if _is_about(error, name)), None)
        raise BadInputError(f"{where}{said or explained(error, Config)}") from error
    except ValueError as error:
        raise BadInputError(f"{where}{error}") from error


def former(name: str) -> str:
    """What a user of a former key is told."""
    return f"{name} is no key any more: {FORMER[name]}"


def todays_name(name: str, where: str) -> str:
    """A key's, or table's, name of today; one of an earlier version is warned of on stderr."""
    table, dot, key = name.partition(".")
    if table not in RENAMED:
        return name
    today = f"{RENAMED[table]}{dot}{key}"
    text = f"{where}{name} is called {today} now; the old name is read until version 2.0"
    print(printable(text), file=sys.stderr)
    return today


def keys() -> list[str]:
    """What one value each can be given for: every key but the software craft's table."""
    return [each.name for each in settings(Config()) if each.name != "stand_in"]


def settings(config: Config) -> list[Setting]:
    """Every key in order, with its value, default and explanation."""
    return list(_settings(config, Config(), ""))


def require_sense(config: Config) -> None:
    """Raise BadInputError, naming the key, for what a type alone cannot tell."""
    try:
        load_vehicle(config.vehicle or DEFAULT_VEHICLE)
    except BadInputError as error:
        raise BadInputError(f"setting vehicle: {error}") from error
    if config.failsafe.stop_s <= config.failsafe.level_s:
        raise BadInputError("setting failsafe.stop_s: must be greater than failsafe.level_s")
    viewer = config.viewer
    if viewer.mode != "off" and viewer.port == viewer.web_port:
        raise BadInputError(
            f"settings viewer.port and viewer.web_port: both are {viewer.port}; they are two "
            "servers, give one another port"
        )


def link_speed(speed: float | Literal["max"]) -> float:
    """The factor behind a configured speed."""
    return float("inf") if speed == "max" else float(speed)


def socket_path(configured: str = "") -> Path:
    """Where the control socket is, for the daemon and for those who talk to it."""
    chosen = configured or os.environ.get("GROUNDSTATION_SOCKET", "")
    if chosen:
        return Path(chosen)
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime) / "groundstation" if runtime else shared_folder()
    return folder / "control.sock"


def shared_folder() -> Path:
    """Where the socket is on a system without runtime folders: in reach of every user."""
    return Path(tempfile.gettempdir()) / f"groundstation-{os.getuid()}"


def _settings(value: Any, default: Any, prefix: str) -> Iterator[Setting]:
    for name, hint in get_type_hints(type(value), include_extras=True).items():
        mine, usual = getattr(value, name), getattr(default, name)
        if isinstance(mine, msgspec.Struct):
            yield from _settings(mine, usual, f"{prefix}{name}.")
            continue
        text = get_args(hint)[1].description if get_origin(hint) is Annotated else ""
        yield Setting(prefix + name, mine, usual, text)


def _changed(config: Config, changes: Mapping[str, Any], where: str, *, strict: bool) -> Config:
    tables: dict[str, Any] = msgspec.to_builtins(config)
    for name, value in changes.items():
        table, _, key = name.rpartition(".")
        (tables[table] if table else tables)[key] = value
    try:
        return msgspec.convert(tables, Config, strict=strict)
    except msgspec.ValidationError as error:
        raise BadInputError(f"{where}: {explained(error, Config)}") from error


def _is_about(error: Exception, name: str) -> bool:
    """Whether a document was refused for this unknown key."""
    table, _, key = name.rpartition(".")
    return f"unknown field `{key}` - at `$.{table}`" in str(error)


def _variable(name: str) -> str:
    return name.replace(".", "_").upper()


# The control API's listening socket: a Unix socket of its owner's.


BACKLOG = 16
PATH_MOST = 107
"""Bytes a Unix socket's address can hold."""


class ControlSocket:
    """The listening socket, held by a lock so that one daemon at a time has it."""

    def __init__(self, path: Path) -> None:
        if len(os.fsencode(path)) > PATH_MOST:
            raise GroundStationError(
                f"control socket {path}: longer than {PATH_MOST} bytes; set a shorter one with "
                "[control] socket or GROUNDSTATION_SOCKET"
            )
        self.path = path
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if path.parent == shared_folder():
                _require_private(path.parent)
            self._lock = _open_lock(path.with_suffix(".lock"))
        except OSError as error:
            raise GroundStationError(f"control socket {path}: {error.strerror}") from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            owner = os.read(self._lock, 32).decode(errors="replace").strip()
            os.close(self._lock)
            raise TakenError(
                f"control socket {path} is taken by another groundstation (process {owner}); stop "
                "it, or give this one its own with GROUNDSTATION_SOCKET or [control] socket"
            ) from error
        os.ftruncate(self._lock, 0)
        os.pwrite(self._lock, str(os.getpid()).encode(), 0)
        if path.exists() and not path.is_socket():
            os.close(self._lock)
            raise GroundStationError(f"control socket {path}: is not a socket; choose another path")
        path.unlink(missing_ok=True)  # left by a daemon that was killed: nobody holds the lock
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        before = os.umask(0o177)
        try:
            self.socket.bind(str(path))
        finally:
            os.umask(before)
        self.socket.listen(BACKLOG)
        self.socket.setblocking(False)

    def close(self) -> None:
        """Remove the socket and release the lock."""
        self.socket.close()
        self.path.unlink(missing_ok=True)
        os.close(self._lock)


def _open_lock(path: Path) -> int:
    """The lock file, made where there is none; nobody else's file, and none of another purpose."""
    lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600)
    found = os.fstat(lock)
    content = os.pread(lock, 32, 0).strip() if stat.S_ISREG(found.st_mode) else b"?"
    if found.st_uid != os.getuid() or (content and not content.isdigit()):
        os.close(lock)
        raise GroundStationError(f"{path}: is no lock file of yours; choose another control socket")
    return lock


def _require_private(folder: Path) -> None:
    """In a folder where anyone can write, someone else may have been there first."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise GroundStationError(
            f"control socket: {folder} is not a folder of yours alone (owner {found.st_uid}, mode "
            f"{stat.S_IMODE(found.st_mode):04o}); remove it, or set GROUNDSTATION_SOCKET"
        )


# How often something may happen.


class RateLimit:
    """A bucket of ``burst`` permissions that refills at ``rate_hz``."""

    def __init__(
        self, rate_hz: float, burst: float, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate_hz, self._burst, self._clock = rate_hz, burst, clock
        self._left, self._at_s = burst, clock()

    def allows(self) -> bool:
        """Take one permission, if there is one."""
        now_s = self._clock()
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._rate_hz)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


# Telling systemd how the daemon does: ready, alive, stopping. Nothing where there is none.


def notify(state: str) -> None:
    """Send one state (``READY=1``) to the service manager, if one has started this."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.setblocking(False)  # a manager that is busy must not hold up the telemetry
        manager.connect(address)
        manager.send(state.encode())


async def pat_watchdog() -> None:
    """Say that the event loop runs, twice as often as the watchdog wants; for ever."""
    period_s = int(os.environ.get("WATCHDOG_USEC", "0")) * 1e-6 / 2
    while period_s > 0:
        notify("WATCHDOG=1")
        await asyncio.sleep(period_s)


def unit(program: str, configuration: str | None) -> str:
    """A systemd unit that runs the daemon as a user of its own, with little else in reach."""
    option = f" --config {configuration}" if configuration else ""
    return f"""\
[Unit]
Description=Ground station for the Crazyflie
After=local-fs.target

[Service]
Type=notify
ExecStart={program} run{option}
Restart=on-failure
RestartSec=2
WatchdogSec=20
TimeoutStopSec=40
User=groundstation
Group=groundstation
SupplementaryGroups=plugdev dialout
RuntimeDirectory=groundstation
RuntimeDirectoryMode=0700
StateDirectory=groundstation
StateDirectoryMode=0750
CacheDirectory=groundstation
WorkingDirectory=%S/groundstation
Environment=GROUNDSTATION_SOCKET=%t/groundstation/control.sock
Environment=GROUNDSTATION_LOG_FORMAT=json
Environment=XDG_CACHE_HOME=%C/groundstation
Environment=NUMBA_CACHE_DIR=%C/groundstation
UMask=0077
NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
ProtectHome=yes
PrivateTmp=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectControlGroups=yes
ProtectClock=yes
ProtectHostname=yes
ProtectProc=invisible
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
LockPersonality=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_NETLINK
IPAddressDeny=any
IPAddressAllow=localhost
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM

[Install]
WantedBy=multi-user.target
"""
