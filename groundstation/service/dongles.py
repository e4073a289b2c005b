"""One program a dongle: opening one that another program flies with would reset it in flight.

A name in the kernel's own space (an abstract socket) holds it: it is one for all users and services
of the machine, whatever folders they see, and is free again when its holder has ended, however.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path

from groundstation.errors import TakenError

ASKERS = 64
"""Programs that may ask who holds one, as long as it is held: the kernel tells each by a connection
that nobody accepts."""
ASK_S = 1.0
_PEER = struct.Struct("3i")  # ucred: process, user, group


class Dongles:
    """The dongles and cables that this program holds, and for which addresses."""

    def __init__(self) -> None:
        self._held: dict[str, socket.socket] = {}
        self._ways: dict[str, frozenset[str]] = {}

    def take(self, ways: Mapping[str, Iterable[str]]) -> None:
        """Hold also what these addresses lead through. Raises TakenError, and changes nothing,
        where another program has one. ways: by address, see ``craft_address.ways_of``."""
        wanted = {way: uri for uri, leads in ways.items() for way in leads}
        with contextlib.ExitStack() as undone:
            new = {
                way: undone.enter_context(_taken(way, uri))
                for way, uri in wanted.items()
                if way not in self._held
            }
            undone.pop_all()
        self._held |= new
        self._ways |= {uri: frozenset(leads) for uri, leads in ways.items()}

    def keep(self, uris: Iterable[str]) -> None:
        """Let go of all that none of these addresses leads through. It takes nothing: a dongle
        that has another number by now is held as it was when it was taken."""
        self._ways = {uri: self._ways[uri] for uri in uris if uri in self._ways}
        for way in self._held.keys() - {way for leads in self._ways.values() for way in leads}:
            self._held.pop(way).close()

    def close(self) -> None:
        """Let go of all. Safe to call twice."""
        self.keep(())


def _taken(way: str, uri: str) -> socket.socket:
    """The name of a dongle, from now on ours."""
    address, ours = f"\0groundstation {way}", socket.socket(socket.AF_UNIX)
    try:
        ours.bind(address)
        ours.listen(ASKERS)
    except OSError as error:
        ours.close()
        if error.errno != errno.EADDRINUSE:
            raise
        raise TakenError(
            f"{uri}: {way} is in use by {_holder(address)}; end it, or take another dongle"
        ) from error
    return ours


def _holder(address: str) -> str:
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as asking:
        asking.settimeout(ASK_S)
        asking.connect(address)
        told = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
        process, *_ = _PEER.unpack(told)
        words = ""
        with contextlib.suppress(OSError):  # of another user, or gone
            line = Path(f"/proc/{process}/cmdline").read_text(errors="replace")
            words = " ".join(os.path.basename(word) for word in line.split("\0")[:3]).strip()
        return f"process {process}" + (f" ({words})" if words else "")
    return "another program"
