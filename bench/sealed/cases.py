"""The acceptance matrix: every case by name, seed, mode and condition."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bench.sealed.hidden import ALWAYS_FAITHFUL, LISTED, MIXED, OUTSIDE
from groundstation.dynamics.vehicle import BUILT_IN

Mode = Literal["clean", "affected"]
Condition = Literal["", "loss", "restart", "low_battery", "other_mass"]
CONDITIONS: tuple[Condition, ...] = ("loss", "restart", "low_battery", "other_mass")
GROUPS = (
    "single",
    "noise",
    "quiet",
    "quiet_noise",
    "faithful",
    "faithful_plus",
    "pair",
    "triple",
    "outside",
)
NO_SMALL_SIZE = ("attitude_filter_lean", "gyro_low_pass")
"""The lean is there or not; a gyro's lag of any bandwidth that flies is far above every limit."""
PAIRS, TRIPLES = 30, 15
PLAIN = "crazyflie1"
"""The craft whose cases do not name it."""


@dataclass(frozen=True, slots=True)
class Case:
    """One hidden craft.

    names: what is hidden on top of the plant. mode: whether the base model comes from flights
    without the effect (``clean``) or from the very flights that have it. craft: the vehicle; one
    with today's firmware is heard as its radio link logs it.
    """

    group: str
    names: tuple[str, ...]
    seed: int
    mode: Mode = "clean"
    condition: Condition = ""
    craft: str = PLAIN

    @property
    def name(self) -> str:
        """Unique, and what ``--case`` takes."""
        hidden = "+".join(self.names) or "nothing"
        craft = "" if self.craft == PLAIN else f"@{self.craft}"
        return f"{self.group}{craft}:{hidden}:{self.seed}:{self.mode}"

    @property
    def number(self) -> int:
        """Seeds everything that is drawn for this case; tells nothing by itself."""
        label = f"{self.group}:{'+'.join(self.names)}:{self.seed}"
        return zlib.crc32(label.encode())

    @property
    def plant(self) -> Literal["reduced", "faithful"]:
        return "faithful" if self.group.startswith("faithful") else "reduced"

    @property
    def torque_noise(self) -> float:
        return 6.0 if self.group.endswith("noise") else 1.0

    @property
    def sensor_noise(self) -> float:
        return 2.0 if self.group.endswith("noise") else 1.0


def matrix(
    groups: tuple[str, ...], modes: tuple[Mode, ...], seeds: int, first: int = 0, craft: str = PLAIN
) -> Iterator[Case]:
    """All cases of some groups, seed by seed so that a part of the matrix is a fair sample.

    seeds: for each name and for each plant, from ``first`` on; pairs, triples and quiet flights
    come ``seeds`` tenths of their full number.
    """
    for seed in range(first, first + seeds):
        for group in groups:
            for mode in modes:
                yield from (replace(case, craft=craft) for case in _of_seed(group, mode, seed))


def named(name: str) -> Case:
    """The case of that name. Raises ValueError where it is none."""
    parts = name.split(":")
    group, _, craft = parts[0].partition("@")
    craft = craft or PLAIN
    modes = ("clean", "affected")
    if len(parts) != 4 or group not in GROUPS or parts[3] not in modes:
        raise ValueError(f"{name!r} is no case; GROUP[@CRAFT]:EFFECT[+EFFECT]:SEED:clean|affected")
    if craft not in BUILT_IN:
        raise ValueError(f"{name!r}: no craft {craft}; there are {', '.join(BUILT_IN)}")
    hidden = () if parts[1] == "nothing" else tuple(parts[1].split("+"))
    unknown = set(hidden) - {*LISTED, *OUTSIDE}
    if unknown:
        raise ValueError(f"{name!r}: no effect {', '.join(sorted(unknown))}")
    mode: Mode = "affected" if parts[3] == "affected" else "clean"
    return replace(_case(group, hidden, int(parts[2]), mode), craft=craft)


def _of_seed(group: str, mode: Mode, seed: int) -> Iterator[Case]:
    if group in ("single", "noise"):
        for name in LISTED:
            yield _case(group, (name,), seed, mode)
    elif group in ("quiet", "quiet_noise"):
        for part in range(10):
            yield _case(group, (), 10 * seed + part, mode)
    elif group == "faithful":
        for part in range(2):
            yield _case(group, (), 2 * seed + part, mode)
    elif group == "faithful_plus":
        for name in LISTED:
            if name not in ALWAYS_FAITHFUL:
                yield _case(group, (name,), seed, mode)
    elif group in ("pair", "triple"):
        count, size = (PAIRS, 2) if group == "pair" else (TRIPLES, 3)
        for number in range(seed * count // 10, (seed + 1) * count // 10):
            yield _case(group, _mixture(number, size), number, mode)
    else:
        for name in OUTSIDE:
            yield _case(group, (name,), seed, mode)


def _mixture(number: int, size: int) -> tuple[str, ...]:
    generator = np.random.default_rng((size, number))
    return tuple(str(name) for name in generator.choice(MIXED, size, replace=False))


def _case(group: str, names: tuple[str, ...], seed: int, mode: Mode) -> Case:
    return Case(group, names, seed, mode, _condition(group, names, seed))


def _condition(group: str, names: tuple[str, ...], seed: int) -> Condition:
    """A third of the seeds of the singles meets what recordings meet in the field."""
    if group not in ("single", "noise") or seed % 3 != 2:
        return ""
    return CONDITIONS[(LISTED.index(names[0]) + seed // 3) % len(CONDITIONS)]
