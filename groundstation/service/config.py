"""The daemon's configuration: one TOML file, typed; the command line overrides it."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError

MEBIBYTE = 1 << 20
Port = Annotated[int, msgspec.Meta(ge=1, le=65535)]
Text = Annotated[str, msgspec.Meta(min_length=1)]


class LinkConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """name: ``stand-in``, ``usb``, ``serial:PORT`` or ``replay:FILE``.

    speed: of stand-in and replay, or "max".
    """

    name: Text = "stand-in"
    speed: float | Literal["max"] = 1.0


class UsbConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """device: VID:PID of the bridge, hexadecimal. serial: its serial number, empty for any."""

    device: str = "0483:5741"
    serial: str = ""


class RecordingConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """folder: where recordings go. enabled: record from the start. low_space_mb: a recording is
    finished cleanly when less than this is free."""

    folder: Text = "sessions"
    enabled: bool = True
    low_space_mb: Annotated[float, msgspec.Meta(ge=0, le=1e9)] = 64.0


class ViewerConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """mode: off, serve or spawn. port: rerun's own. web_port: the browser's."""

    mode: Literal["off", "serve", "spawn"] = "off"
    port: Port = 9876
    web_port: Port = 9090


class ControlConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """socket: path of the control socket; empty for the user's runtime folder."""

    socket: str = ""


class DeadManConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What happens when a client that commands falls silent, in seconds.

    level_s: without a setpoint while motors run: level attitude. stop_s: motors off and the
    lease is over. lease_s: without any request while motors stand: the lease is over.
    """

    level_s: Annotated[float, msgspec.Meta(ge=0.05, le=0.5)] = 0.2
    stop_s: Annotated[float, msgspec.Meta(ge=0.1, le=2.0)] = 0.6
    lease_s: Annotated[float, msgspec.Meta(ge=1.0, le=60.0)] = 5.0


class Config(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Everything the daemon can be told.

    command: URI of the command link (``udp://HOST:PORT`` for a stand-in, ``radio://...`` for a
    craft), empty for none. vehicle: profile named in the recording. stand_in: settings of the
    software craft.
    """

    link: LinkConfig = LinkConfig()
    usb: UsbConfig = UsbConfig()
    recording: RecordingConfig = RecordingConfig()
    viewer: ViewerConfig = ViewerConfig()
    control: ControlConfig = ControlConfig()
    dead_man: DeadManConfig = DeadManConfig()
    command: str = ""
    vehicle: Text = "crazyflie1"
    stand_in: dict[str, Any] = {}


def load_config(path: Path | None) -> Config:
    """Read the file, or the defaults when there is none. Errors name the key."""
    if path is None:
        return Config()
    try:
        return msgspec.toml.decode(path.read_bytes(), type=Config)
    except OSError as error:
        raise BadInputError(f"configuration {path}: {error.strerror or error}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"configuration {path}: {error}") from error


def require_sense(config: Config) -> None:
    """Raise BadInputError, naming the key, for what a type alone cannot tell."""
    try:
        load_vehicle(config.vehicle)
    except BadInputError as error:
        raise BadInputError(f"setting vehicle: {error}") from error
    if config.dead_man.stop_s <= config.dead_man.level_s:
        raise BadInputError("setting dead_man.stop_s: must be greater than dead_man.level_s")
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
