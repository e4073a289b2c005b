"""From what the user types after ``--link`` to a link. Backends load on demand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from groundstation.clock import HostClock
from groundstation.errors import BadInputError
from groundstation.links.base import Link

KINDS = "stand-in, replay:FILE"


def make_link(
    name: str, *, speed: float, stand_in: dict[str, Any], clock: HostClock | None = None
) -> Link:
    """``stand-in`` or ``replay:FILE``. Raises BadInputError for anything else."""
    kind, _, argument = name.partition(":")
    if kind == "stand-in" and not argument:
        from groundstation.links.stand_in import StandInLink

        return StandInLink(stand_in, speed=speed, clock=clock)
    if kind == "replay" and argument:
        from groundstation.links.replay import ReplayLink

        return ReplayLink(Path(argument), speed=speed, clock=clock)
    raise BadInputError(f"link {name!r} is not known: use one of {KINDS}")
