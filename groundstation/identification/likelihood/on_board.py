"""The firmware's own filters behind gyro and accelerometer: which of them flights show."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from groundstation.dynamics.model import EffectTerm, Estimate
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import Vehicle
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.parameters import Point, Variant
from groundstation.identification.likelihood.problem import Prior

ON_BOARD = {name: effect for name, effect in EFFECTS.items() if effect.on_board}
DOUBT = 0.01
SHOWS_S = 1.0 / 240.0
"""Rows further apart hold mostly what the slowest of them (30 Hz) has let pass, and not its lag."""


def filters_of(vehicle: Vehicle, flights: Sequence[Flight]) -> dict[str, float]:
    """Corner in Hz of each on-board filter that these flights show, by its effect's name.

    Not the accelerometer's where rotor speeds were measured: along z, what is fast behind the
    filter is less thrust than the noise of these speeds, and would say how late everything is.
    """
    if any(flight.period_s > SHOWS_S for flight in flights):
        return {}
    measured = any(flight.rotor_measured for flight in flights)
    felt = all(flight.has_accelerometer for flight in flights)
    lacking = {"modelled rotors": measured, "accelerometer": not felt}
    return {
        name: corner
        for name, effect in ON_BOARD.items()
        if (corner := getattr(vehicle, effect.on_board)) > 0.0
        and not any(lacking.get(need, False) for need in effect.needs)
    }


def in_plane_hz(vehicle: Vehicle, flights: Sequence[Flight], known: Collection[str]) -> float:
    """Corner of the filter that forces in the rotors' plane have passed, which no effect holds.

    known: effects of the model.
    """
    shown = all(flight.period_s < SHOWS_S for flight in flights)
    measured = any(flight.rotor_measured for flight in flights)
    held = any("accelerometer" in EFFECTS[name].needs for name in known if name in ON_BOARD)
    return vehicle.accelerometer_filter_hz if shown and measured and not held else 0.0


def filter_prior(known: Sequence[Variant], start: Point) -> list[Prior]:
    """What is known before a search of the filters among a model's effects: the firmware's
    numbers, but for what a filter in steps of 1 ms differs from a smooth one."""
    keys = [key for one in known if one.effect in ON_BOARD for key in one.keys]
    return [
        ((key,), {key: start[key]}, np.array([[(DOUBT * start[key]) ** -2]]))
        for key in keys
        if start[key] != 0.0
    ]


def filter_terms(corners: dict[str, float]) -> list[EffectTerm]:
    """The filters as models hold them: the firmware's numbers, without an error."""
    return [
        EffectTerm(name, {one.name: Estimate(corner, None, one.unit)})
        for name, corner in corners.items()
        for one in EFFECTS[name].sizes
    ]
