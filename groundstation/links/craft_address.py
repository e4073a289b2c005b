"""Where a craft is reached: addresses as cflib writes them, by which dongle or cable they lead, and
what answers there."""

from __future__ import annotations

import contextlib
import io
import ipaddress
import re
from collections.abc import Iterable, Sequence
from urllib.parse import urlsplit

from groundstation.errors import BadInputError, install

ADDRESSES = (
    "udp://HOST:PORT, usb://0 or radio://0/80/2M/E7E7E7E7E7 (dongle or its serial number, channel 0"
    " to 125, rate 250K, 1M or 2M, address of ten hexadecimal digits)"
)
LOOKED_THROUGH = ("radio://0/0/2M", "usb://0")
"""The dongle and the cable that ``in_reach`` opens."""
HINT = f"install it with {install('radio')}"

_RADIO = re.compile(
    r"radio://(?P<dongle>\d{1,9}|[0-9A-Fa-f]{10,32})/(?P<channel>\d{1,3})"
    r"(/(250K|1M|2M)(/[0-9A-Fa-f]{1,10})?)?/?(\?rate_limit=\d+)?"
)
_CABLE = re.compile(r"usb://(?P<cable>\d+)")
_LAST_CHANNEL, _LEAST_SERIAL = 125, 10


def is_address(uri: str) -> bool:
    """Whether cflib can make anything of it: of what it cannot it says so in words of Python, and
    a wrong channel it finds only once there is a dongle."""
    if radio := _RADIO.fullmatch(uri):
        return int(radio["channel"]) <= _LAST_CHANNEL
    if not uri.startswith("udp://"):
        return _CABLE.fullmatch(uri) is not None
    try:
        parts = urlsplit(uri)
        return bool(parts.hostname and parts.port)
    except ValueError:  # the port
        return False


def is_software(uri: str) -> bool:
    """Whether a software craft of this machine answers there: UDP leads to real ones as well."""
    if uri.startswith("software:"):
        return True
    try:
        address = udp_address(uri)
        host = "" if address is None else address[0]
        return host == "localhost" or (
            isinstance(found := ipaddress.ip_address(host), ipaddress.IPv4Address)
            and found.is_loopback
        )
    except (BadInputError, ValueError):
        return False


def udp_address(uri: str) -> tuple[str, int] | None:
    """Host and port of ``udp://HOST:PORT``, None for another scheme. Raises BadInputError."""
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


def ways_of(uris: Iterable[str]) -> dict[str, set[str]]:
    """Names of the dongle or cable that each address leads through, empty for another link.

    A dongle has two, its number and its serial number, where it is plugged in and tells: USB is
    asked, so not on the event loop.
    """
    return {uri: _ways_of(uri) for uri in uris}


def _ways_of(uri: str) -> set[str]:
    if cable := _CABLE.fullmatch(uri):
        return {f"cable {int(cable['cable'])}"}
    radio = _RADIO.fullmatch(uri)
    return set() if radio is None else both_names(radio["dongle"], _serial_numbers())


def both_names(dongle: str, plugged_in: Sequence[str]) -> set[str]:
    """Of a dongle given by one of them. plugged_in: serial numbers in the order of the numbers."""
    dongle = str(int(dongle)) if len(dongle) < _LEAST_SERIAL else dongle.upper()
    names = {dongle}
    for number, serial in enumerate(plugged_in):
        if dongle in (str(number), serial.upper()):
            names |= {str(number), serial.upper()}
    return {f"dongle {name}" for name in names}


def _serial_numbers() -> list[str]:
    """Of the dongles that are plugged in; empty where a user may not read one, or without cflib."""
    try:
        from cflib.drivers.crazyradio import get_serials

        return [str(serial) for serial in get_serials()]
    except Exception:  # of libusb, pyusb and cflib: whoever opens the dongle is told why
        return []


def in_reach() -> list[str]:
    """Addresses of the craft that answer a dongle or a cable; takes seconds with a dongle.

    Raises BadInputError without cflib.
    """
    try:
        from cflib.crtp.radiodriver import RadioDriver
        from cflib.crtp.usbdriver import UsbDriver
    except ImportError as error:
        raise BadInputError(f"to look for craft cflib is needed: {HINT}") from error
    found: list[str] = []
    with contextlib.redirect_stdout(io.StringIO()):  # cflib prints what it does not find
        for driver in (RadioDriver(), UsbDriver()):
            found += [uri for uri, *_ in driver.scan_interface(None)]
    return found
