"""Every kind of link: how a user types it after ``--link``, and the module that makes it."""

from __future__ import annotations

from groundstation.errors import BadInputError

LINKS = {
    "stand-in": "stand_in",
    "stand-in:MODEL": "stand_in",
    "usb": "usb",
    "serial:PORT": "serial",
    "replay:FILE": "replay",
    "radio://0/80/2M/E7E7E7E7E7": "crazyflie_log",
    "usb://0": "crazyflie_log",
    "udp://HOST:PORT": "crazyflie_log",
}
"""Form -> module of ``groundstation.links``, whose ``make(options)`` gives the link. By the control
API a FILE can only be one of the recordings folder, a PORT one of ``/dev``."""
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
