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
    "stand-in, stand-in:MODEL, replay:FILE, usb, serial:PORT, radio://0/80/2M/E7E7E7E7E7, usb://0,"
    " udp://HOST:PORT"
)
CRAFT = ("radio://", "usb://", "udp://")
"""Links to a craft that speaks for itself."""
STAND_IN = "stand-in"
_TAKES_ARGUMENT = {STAND_IN: (False, True), "replay": (True,), "usb": (False,), "serial": (True,)}


def make_link(
    name: str,
    *,
    speed: float,
    stand_in: dict[str, Any],
    model: str = "",
    command: str = "",
    usb: dict[str, str] | None = None,
    rate_hz: int = 0,
    wanted: Sequence[str] = (),
    clock: HostClock | None = None,
) -> Link:
    """A link of one of ``KINDS``, else BadInputError.

    model: file of the model that ``stand-in:MODEL`` names, where MODEL is not the file itself.
    usb: ``device`` (VID:PID) and ``serial`` of the bridge where they are not the usual ones.
    command: URI of the command link: a stand-in answers there when it is ``udp://``.
    rate_hz, wanted: rows a second (0: what the link bears), and further variables, of a craft's
    own log.
    """
    if name.startswith(CRAFT):
        from groundstation.links.crazyflie_log import CrazyflieTelemetry

        return CrazyflieTelemetry(name, rate_hz=rate_hz, wanted=wanted, clock=clock)
    kind, argument = split_name(name)
    if kind == STAND_IN:
        from groundstation.links.stand_in import StandInLink

        flown = {**stand_in, "plant": "model", "craft": model or argument, "effects": {}}
        return StandInLink(
            flown if argument else stand_in,
            name=name,
            speed=speed,
            crtp=_udp_address(command),
            clock=clock,
        )
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
    if bool(colon) not in _TAKES_ARGUMENT.get(kind, ()) or bool(colon) != bool(argument):
        raise BadInputError(f"link {name!r} is not known: use one of {KINDS}")
    return kind, argument


def is_stand_in(name: str) -> bool:
    """Whether a link's name is that of a software craft, as configured or flying a model."""
    return name.partition(":")[0] == STAND_IN


def make_command_link(uri: str, *, clock: HostClock | None = None) -> CommandLink:
    """``udp://HOST:PORT`` for a stand-in, ``radio://...`` for a craft."""
    from groundstation.links.crazyflie import CrazyflieLink

    return CrazyflieLink(uri, clock=clock)


async def serve_commands(link: Link, uri: str) -> None:
    """Let a stand-in answer at ``uri``; other craft have addresses of their own. Raises
    BadInputError for an address of another kind, TakenError for a port that is taken."""
    from groundstation.links.stand_in import StandInLink

    address = _udp_address(uri)
    if isinstance(link, StandInLink):
        if address is None:
            raise BadInputError(f"command link {uri}: the stand-in answers at udp://HOST:PORT only")
        await link.serve_at(address)


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
