"""The manoeuvres that flights are put together of, within limits of tilt and space.

Signs are those of the telemetry: roll left side up, pitch nose down, yaw rate counter-clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from groundstation.control.programme import (
    AHEAD_S,
    HELD_S,
    NEAR_M,
    RATE_HZ,
    REST_S,
    SPEED_M_S,
    carried_m,
    heading_rad,
)
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import Array

TAKE_OFF_S, LANDING_S = 4.0, 3.0
"""Until its hover is known, and down from 0.5 m."""
PREFLIGHT_S = 4.0
"""What a flight takes beside its programme: on the ground."""


@dataclass(frozen=True, slots=True)
class Limits:
    """tilt_deg: the most that is commanded. reach_m: to either side of where it took off. height_m:
    above the ground."""

    tilt_deg: float = 12.0
    reach_m: float = 1.0
    height_m: float = 0.5

    @property
    def step_m(self) -> float:
        """The largest step of height: up and down by it leaves half the height below."""
        return min(0.2, 0.4 * self.height_m)

    def within(self, table: Array) -> float:
        """What leans are multiplied with, 1 at most, so that a craft that begins near its place can
        brake within its space at any time."""
        most = (self.reach_m - NEAR_M) / max(carried_m(table, AHEAD_S), 1e-9)
        return min(1.0, self.tilt_deg / max(np.abs(table[:, :2]).max(), 1e-9), most)

    def lean(self, wanted_deg: float, hold_s: float) -> float:
        """An angle that a doublet may have whose levels are held for so long."""
        held = np.ones((round(hold_s * RATE_HZ), 1))
        return wanted_deg * self.within(np.vstack([held, -held]) * [wanted_deg, 0.0, 0.0])


def require_limits(limits: Limits) -> None:
    """Raises BadInputError for limits in which nothing can be learnt."""
    if not 0.3 <= limits.height_m <= 2.0:
        raise BadInputError(f"--height {limits.height_m:g}: must be 0.3..2 m")
    if not 0.5 <= limits.reach_m <= 20.0:
        raise BadInputError(
            f"--space: {2 * limits.reach_m:g} m across is too little or no room: give 1x1..40x40 m"
        )


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """table: roll, pitch (deg), yaw rate (deg/s), metres above the height held, every 10 ms
    (k, 4)."""

    name: str
    table: Array

    @property
    def seconds(self) -> float:
        return len(self.table) / RATE_HZ

    @property
    def held_s(self) -> float:
        """Until the craft is back and rests, about."""
        return self.seconds + HELD_S


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """Manoeuvres in order; what a flight is for, in words."""

    manoeuvres: tuple[Manoeuvre, ...]
    purpose: str

    rest_s = REST_S
    speed_most_m_s = SPEED_M_S

    def parts(self) -> list[tuple[str, Array]]:
        """Name and table of each manoeuvre."""
        return [(one.name, one.table) for one in self.manoeuvres]

    @property
    def seconds(self) -> float:
        """In the air, about."""
        return TAKE_OFF_S + sum(one.held_s for one in self.manoeuvres) + LANDING_S

    def timeline(self) -> list[dict[str, Any]]:
        """When to fly what: ``at_s`` from the end of the take-off, about, ``seconds``, ``fly``."""
        rows, at_s = [], 0.0
        for one in self.manoeuvres:
            rows.append({"at_s": at_s, "seconds": one.seconds, "fly": one.name})
            at_s += one.held_s
        return rows


def library(limits: Limits, seed: int = 0) -> dict[str, Manoeuvre]:
    """Every manoeuvre by name, each within the limits and back where it began. seed: of the random
    ones."""
    time = np.arange(round(6.0 * RATE_HZ)) / RATE_HZ
    still = np.zeros(len(time))
    doublet = np.repeat([1.0, -1.0, 0.0, -1.0, 1.0, 0.0] * 2, RATE_HZ // 2)
    sweep = np.cos(2 * math.pi * (0.6 * time + (5.0 - 0.6) * time**2 / 12.0))
    to_and_fro = np.cos(2 * math.pi * time / 2.0)
    steps = np.repeat([1.0, 0.0, -1.0, 0.0, 1.0, 0.0], RATE_HZ)
    random = np.random.default_rng(seed)
    tilt = limits.tilt_deg

    def levels(hold_s: float, *pattern: float) -> Array:
        """A pattern of levels, again and again with signs at random."""
        count = round(hold_s * RATE_HZ)
        signs = random.choice([-1.0, 1.0], len(time) // (count * len(pattern)) + 1)
        return np.repeat(np.outer(signs, pattern), count)[: len(time)]

    def of(name: str, **axes: Array) -> Manoeuvre:
        """Leans are those of the heading at its begin, so that they come back in a turn too."""
        roll, pitch, yaw, above = (
            axes.get(one, still) for one in ("roll", "pitch", "yaw", "above")
        )
        lean = (pitch - 1j * roll) * np.exp(-1j * heading_rad(yaw))
        table = np.column_stack([-lean.imag, lean.real, yaw, above])
        table[:, :2] *= limits.within(table)
        return Manoeuvre(name, table)

    back = (1.0, -1.0, -1.0, 1.0)
    made = [
        of("hover"),
        of("thrust steps", above=limits.step_m * steps),
        of("roll doublets", roll=0.75 * tilt * doublet),
        of("pitch doublets", pitch=0.75 * tilt * doublet),
        of("yaw steps", yaw=90.0 * doublet),
        of("roll chirp", roll=0.5 * tilt * sweep),
        of("pitch chirp", pitch=0.5 * tilt * sweep),
        of("yaw chirp", yaw=60.0 * sweep),
        of("to and fro, left and right", roll=tilt * to_and_fro),
        of("to and fro, ahead and back", pitch=tilt * to_and_fro),
        of(
            "turn with doublets",
            yaw=0.0 * still + 90.0,
            pitch=0.75 * tilt * doublet,
            roll=0.75 * tilt * np.roll(doublet, RATE_HZ // 2),
        ),
        of(
            "all axes at random",
            roll=0.75 * tilt * levels(0.25, *back),
            pitch=0.75 * tilt * levels(0.3, *back),
            yaw=60.0 * levels(0.5, 1.0, -1.0),
            above=limits.step_m * levels(1.0, 1.0, 0.0),
        ),
    ]
    return {one.name: one for one in made}


HOVER = ("hover", "thrust steps", "yaw steps")
BODY = ("roll doublets", "pitch doublets", "yaw steps", "roll chirp", "pitch chirp")
PROOF = ("all axes at random", "roll doublets", "turn with doublets", "pitch doublets")
"""Of the flights that need no model to be planned."""


def flight_of(names: Sequence[str], purpose: str, limits: Limits, seed: int) -> FlightPlan:
    """A flight of named manoeuvres."""
    known = library(limits, seed)
    return FlightPlan(tuple(known[name] for name in names), purpose)
