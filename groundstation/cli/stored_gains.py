"""Gains that a craft keeps while it is switched off: ``--store`` and ``--undo`` of its flights."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import typer

from groundstation import BadInputError, GroundStationError, Pilot

STORE = typer.Option(
    False, "--store", help="Have the craft keep the gains when it is switched off."
)


def require_storing(pilot: Pilot, store: bool = True, *, restore: bool = False) -> None:
    """Before anything flies: raises BadInputError where gains are to be stored (store) by a craft
    that keeps none, or to be put back as well (restore)."""
    if not store:
        return
    if restore:
        raise BadInputError("--store keeps the gains, --restore puts the former back: give one")
    try:
        pilot.stored()
    except GroundStationError as error:
        raise BadInputError(f"--store: {error}; nothing was flown") from error


def store_gains(pilot: Pilot, flown: str) -> list[str]:
    """Have a craft that has landed keep its gains; the names of those that it has stored
    then. flown: what was done, said where it does not."""
    try:
        found = pilot.store()
    except GroundStationError as error:
        raise GroundStationError(f"{flown}, but its gains are not all stored: {error}") from error
    return stored_in(found)


def clear_gains(pilot: Pilot) -> dict[str, float]:
    """Have a craft forget the gains that it has stored: their values in its firmware. None where it
    stores none."""
    if not pilot.ask("GET", "/status")["command"]["stores"]:
        return {}
    found = pilot.stored()
    gains = {name: found[name]["default"] for name in stored_in(found)}
    if gains:
        pilot.clear_stored(*gains)
    return gains


def stored_in(found: Mapping[str, Any]) -> list[str]:
    """The names of the gains that are stored."""
    return sorted(
        name for name, one in found.items() if one["stored"] is not None and name.startswith("pid_")
    )
