"""From what the user types after ``--link`` to a link. Backends load on demand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from groundstation.clock import HostClock
from groundstation.errors import BadInputError
from groundstation.links.base import Link
from groundstation.links.command import CommandLink

KINDS = (
    "stand-in, replay:FILE, usb, serial:PORT, radio://0/80/2M/E7E7E7E7E7, usb://0, udp://HOST:PORT"
)
CRAFT = ("radio://", "usb://", "udp://")
"""Links to a craft that speaks for itself."""
_TAKES_ARGUMENT = {"stand-in": False, "replay": True, "usb": False, "serial": True}


def make_link(
    name: str,
    *,
    speed: float,
    stand_in: dict[str, Any],
    command: str = "",
    usb: dict[str, str] | None = None,
    rate_hz: int = 100,
    wanted: Sequence[str] = (),
    clock: HostClock | None = None,
) -> Link:
    """A link of one of ``KINDS``, else BadInputError.

    usb: ``device`` (VID:PID) and ``serial`` of the bridge where they are not the usual ones.
    command: URI of the command link: a stand-in answers there when it is ``udp://``.
    rate_hz, wanted: rows a second, and further variables, of a craft's own log.
    """
    if name.startswith(CRAFT):
        from groundstation.links.crazyflie_log import CrazyflieTelemetry

        return CrazyflieTelemetry(name, rate_hz=rate_hz, wanted=wanted, clock=clock)
    kind, argument = split_name(name)
    if kind == "stand-in":
        from groundstation.links.stand_in import StandInLink

        return StandInLink(stand_in, speed=speed, crtp=_udp_address(command), clock=clock)
    if kind == "replay":
        from groundstation.links.replay import ReplayLink

        return ReplayLink(Path(argument), speed=speed, clock=clock)
    if kind == "usb":
        from groundstation.links.usb import UsbLink

        return UsbLink(**(usb or {}), clock=clock)
    from groundstation.links.serial import SerialLink

    return SerialLink(argument, clock=clock)


def split_name(name: str) -> tuple[str, str]:
    """Kind of link and what follows its colon. Raises BadInputError for no known link."""
    if name.startswith(CRAFT):
        scheme, _, rest = name.partition("://")
        return scheme, rest
    kind, colon, argument = name.partition(":")
    if _TAKES_ARGUMENT.get(kind) != bool(colon) or bool(colon) != bool(argument):
        raise BadInputError(f"link {name!r} is not known: use one of {KINDS}")
    return kind, argument


def make_command_link(uri: str, *, clock: HostClock | None = None) -> CommandLink:
    """``udp://HOST:PORT`` for a stand-in, ``radio://...`` for a craft."""
    from groundstation.links.crazyflie import CrazyflieLink

    return CrazyflieLink(uri, clock=clock)


def _udp_address(uri: str) -> tuple[str, int] | None:
    parts = urlsplit(uri)
    if parts.scheme != "udp":
        return None
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if host is None or port is None:
        raise BadInputError(f"command link {uri!r}: give it as udp://HOST:PORT")
    return host, port
