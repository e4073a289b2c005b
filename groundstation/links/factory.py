"""From what the user types after ``--link`` to a link. Backends load on demand."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from groundstation.errors import BadInputError
from groundstation.links.base import Link, LinkOptions
from groundstation.links.clock import HostClock
from groundstation.links.command import CommandLink
from groundstation.links.craft_address import udp_address
from groundstation.links.names import module_of, split_name


def make_link(name: str, **options: Any) -> Link:
    """A link of one of ``names.LINKS``, else BadInputError. options: see ``LinkOptions``."""
    module = import_module(f"groundstation.links.{module_of(name)}")
    link: Link = module.make(LinkOptions(name=name, argument=split_name(name)[1], **options))
    return link


def make_command_link(uri: str, *, clock: HostClock | None = None) -> CommandLink:
    """``udp://HOST:PORT`` for a stand-in, ``radio://...`` for a craft."""
    from groundstation.links.crazyflie import CrazyflieLink

    return CrazyflieLink(uri, clock=clock)


async def serve_commands(link: Link, uri: str) -> None:
    """Let a stand-in answer at ``uri``; other craft have addresses of their own. Raises
    BadInputError for an address of another kind, TakenError for a port that is taken."""
    from groundstation.links.stand_in import StandInLink

    address = udp_address(uri)
    if isinstance(link, StandInLink):
        if address is None:
            raise BadInputError(f"command link {uri}: the stand-in answers at udp://HOST:PORT only")
        await link.serve_at(address)
