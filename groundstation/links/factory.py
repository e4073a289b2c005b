"""Links by their names."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from groundstation.errors import BadInputError
from groundstation.links.base import Link, LinkOptions
from groundstation.links.command import CommandLink, HostClock, udp_address

# Every kind of link: how a user types it after ``--link``, and the module that makes it.


LINKS = {
    "stand-in": "stand_in",
    "stand-in:MODEL": "stand_in",
    "usb": "usb",
    "serial:PORT": "serial",
    "replay:FILE": "replay",
    "radio://0/80/2M/E7E7E7E7E7": "crazyflie",
    "usb://0": "crazyflie",
    "udp://HOST:PORT": "crazyflie",
}
"""Form -> module of ``groundstation.links``, whose ``make(options)`` gives the link. A new one is a
module, a row here and a class in ``tests/links/test_contract.py``; its settings stand in
``LinkOptions``, ``service/config.py`` and ``service/craft_links.py``. A form with ``://`` is a
craft that speaks for itself. What a client of the control API may ask for,
``control.permitted_link`` says by the word behind the colon: a FILE of the recordings folder, a
PORT of ``/dev``, a MODEL that a job made; anything else it refuses."""
KINDS = ", ".join(LINKS)
CRAFT = tuple(form[: form.index("://") + 3] for form in LINKS if "://" in form)
"""Links to a craft that speaks for itself."""
STAND_IN = "stand-in"


def split_name(name: str) -> tuple[str, str]:
    """Kind of link and what follows its colon. Raises BadInputError for no known link."""
    if scheme := _scheme(name):
        return scheme.removesuffix("://"), name.removeprefix(scheme)
    kind, colon, argument = name.partition(":")
    forms = [form.partition(":")[:2] for form in LINKS if not _scheme(form)]
    if (kind, colon) not in forms or bool(colon) != bool(argument):
        raise BadInputError(f"link {name!r} is not known: use one of {KINDS}")
    return kind, argument


def argument_of(name: str) -> str:
    """What the row of a link's name calls what follows the colon: FILE, PORT, MODEL; empty where
    nothing does, or an address. Raises BadInputError for no known link."""
    kind, argument = split_name(name)
    forms = [form.partition(":") for form in LINKS if not _scheme(form)]
    return next((what for one, _, what in forms if one == kind and what and argument), "")


def module_of(name: str) -> str:
    """The module behind a link's name. Raises BadInputError for no known link."""
    start = _scheme(name) or split_name(name)[0]
    return next(module for form, module in LINKS.items() if form.startswith(start))


def is_stand_in(name: str) -> bool:
    """Whether a link's name is that of a software craft, as configured or flying a model."""
    return name.partition(":")[0] == STAND_IN


def _scheme(name: str) -> str:
    return next((one for one in CRAFT if name.startswith(one)), "")


# From what the user types after ``--link`` to a link. Backends load on demand.


def make_link(name: str, **options: Any) -> Link:
    """A link of one of ``LINKS``, else BadInputError. options: see ``LinkOptions``."""
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
