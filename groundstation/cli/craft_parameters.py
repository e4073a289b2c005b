"""Parameters of a craft that a flight changes: written, read back, and put back at its end."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from groundstation import GroundStationError, Pilot, socket_path
from groundstation.cli.left_changed import (
    Written,
    changes_left,
    forget_changes,
    note_changes,
    still_changed,
)
from groundstation.cli.terminal import say
from groundstation.service.motor_stop import BY_OPERATOR

if TYPE_CHECKING:
    from collections.abc import Mapping


def write_parameters(pilot: Pilot, values: Mapping[str, float]) -> None:
    """Write parameters and require that the craft read back the same numbers."""
    import numpy as np

    if not values:
        return
    back = pilot.write(dict(values))
    for name, value in values.items():
        if np.float32(back[name]) != np.float32(value):
            raise GroundStationError(
                f"{name}: wrote {value:g}, the craft says {back[name]:g}; nothing was flown"
            )


def put_back(
    pilot: Pilot,
    client: str,
    back: Mapping[str, float],
    earlier: dict[str, float],
    written: Written,
    aborted: str,
) -> None:
    """Put parameters back. Once that has worked the note holds no more than ``earlier``, what an
    interrupted flight changed and this one did not touch. client: who commands anew where the
    operator has ended the lease."""
    uri = pilot.lease["uri"]
    try:
        if aborted == BY_OPERATOR and back:  # its lease is over, and its craft stands
            with Pilot(socket_path(), client) as anew:
                if anew.lease["uri"] != uri:
                    raise GroundStationError(f"the daemon commands {anew.lease['uri']} now")
                write_parameters(anew, back)
        else:
            write_parameters(pilot, back)
    except (GroundStationError, KeyboardInterrupt) as error:
        say(
            f"the former gains could not be put back ({error}): `groundstation pid fly --undo`",
            error=True,
        )
        return
    if earlier:
        note_changes(uri, earlier, written)
    else:
        forget_changes(uri)
    if back and aborted:
        say("the former gains are back", error=True)


def left_on(uri: str, present: dict[str, float]) -> tuple[dict[str, float], Written]:
    """What an interrupted flight found on this craft and the craft still holds as that changed it,
    and what it wrote; empty where there is nothing such."""
    left = changes_left(uri)
    if left is None:
        return {}, {}
    former = still_changed(left, present)
    if not former:
        forget_changes(uri)
        return {}, {}
    _tell_left(uri, left, former, present)
    return former, left["written"]


def put_back_left(pilot: Pilot, present: dict[str, float]) -> dict[str, float]:
    """Put back what an interrupted flight left changed on the craft, which has ``present``: the
    former values."""
    uri = pilot.lease["uri"]
    former, _ = left_on(uri, present)
    if former:
        write_parameters(pilot, former)
        forget_changes(uri)
    return former


def _tell_left(
    uri: str, left: dict[str, Any], former: dict[str, float], present: dict[str, float]
) -> None:
    when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(left["time"]))
    say(f"the flight of {when} on {uri} was interrupted and left changed:", error=True)
    for name, value in former.items():
        say(f"  {name}: was {value:g}, is {present[name]:g}", error=True)
    say("'groundstation pid fly --undo' puts the former values back", error=True)


def why_aborted(error: GroundStationError) -> str:
    """What a flight that ended so is told to have been cut short by."""
    return BY_OPERATOR if BY_OPERATOR in str(error) else str(error)
