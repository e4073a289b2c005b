"""The firmware's own filters behind gyro and accelerometer: which of them flights show."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from groundstation.dynamics.model import EffectTerm, Estimate
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import Vehicle
from groundstation.identification.flight import Flight

ON_BOARD = {name: effect for name, effect in EFFECTS.items() if effect.on_board}
SHOWS_S = 1.0 / 240.0
"""Rows further apart hold mostly what the slowest of them (30 Hz) has let pass, and not its lag."""


def filters_of(vehicle: Vehicle, flights: Sequence[Flight]) -> dict[str, float]:
    """Corner in Hz of each on-board filter that these flights show, by its effect's name.

    Where rotor speeds were recorded not the accelerometer's: what is fast in them is mostly noise,
    and along z, behind the filter, it would say how late everything is. On real flights a search
    then lost what it had named (payload: gap 4.5, with both filters 8.4).
    """
    if not _fast(flights):
        return {}
    felt = all(flight.has_accelerometer for flight in flights) and not _speeds_recorded(flights)
    return {
        name: corner
        for name, effect in ON_BOARD.items()
        if (corner := getattr(vehicle, effect.on_board)) > 0.0
        and (felt or "accelerometer" not in effect.needs)
    }


def in_plane_hz(vehicle: Vehicle, flights: Sequence[Flight], known: Collection[str]) -> float:
    """Corner of the filter that forces in the rotors' plane have passed, which no effect holds.

    known: effects of the model.
    """
    held = any("accelerometer" in EFFECTS[name].needs for name in known if name in ON_BOARD)
    shown = _fast(flights) and _speeds_recorded(flights) and not held
    return vehicle.accelerometer_filter_hz if shown else 0.0


def _fast(flights: Sequence[Flight]) -> bool:
    return all(flight.period_s < SHOWS_S for flight in flights)


def _speeds_recorded(flights: Sequence[Flight]) -> bool:
    return any(np.isfinite(flight.run.rotor_rev_s).any() for flight in flights)


def filter_terms(corners: dict[str, float]) -> list[EffectTerm]:
    """The filters as models hold them: the firmware's numbers, without an error."""
    return [
        EffectTerm(name, {one.name: Estimate(corner, None, one.unit)})
        for name, corner in corners.items()
        for one in EFFECTS[name].sizes
    ]
