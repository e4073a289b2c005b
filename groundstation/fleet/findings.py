"""What a fleet's fits tell: crafts' values, what changed since when, who differs, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from groundstation.fleet.flight_fit import QUANTITIES, RELATIVE, ROTORS, WORDS
from groundstation.fleet.parts import Row
from groundstation.fleet.population import (
    Change,
    Population,
    change_in,
    discoveries,
    level,
    population,
    scatter_variance,
)
from groundstation.telemetry.arrays import Array

FALSE_SHARE = 0.05
"""At most this share of what is named is chance; a fleet without faults is wronged in as many."""
TOGETHER = 3
"""Changes of one craft so many flights apart are one event."""
OPPOSITE = 0.6
"""Share of a rotor's change that the one across shows the other way where the weight moved."""

MOST = 0.5
"""Share of a change of thrust that one rotor must account for to be named for it."""

DRAWN = 40
"""Crafts with rows and lines of their own where there are many: those with findings first."""


@dataclass(frozen=True, slots=True)
class Series:
    """One quantity of one craft. values (n,), their logarithms where it is compared by shares;
    errors (n,) of the fits; begun: dates of the flights."""

    craft: str
    quantity: str
    begun: tuple[str, ...]
    values: Array
    errors: Array


@dataclass(frozen=True, slots=True)
class CraftValue:
    """A craft's present value, alone and with what the other crafts say of one like it."""

    craft: str
    quantity: str
    flights: int
    value: float
    stderr: float
    shrunk: float
    shrunk_stderr: float


@dataclass(frozen=True, slots=True)
class Finding:
    """kind: change, drift or differs. size, stderr: a share where the quantity is one, otherwise in
    its unit; of a drift over all flights. since: date of the first flight after it, which is
    number ``flight`` of ``flights``. moved: other quantities that changed with it."""

    craft: str
    kind: str
    quantity: str
    size: float
    stderr: float
    p: float
    since: str
    flight: int
    flights: int
    moved: tuple[str, ...]
    text: str


@dataclass(frozen=True, slots=True)
class Fleet:
    """values: by craft and quantity; populations: by quantity; scatter: standard deviation from
    flight to flight; series: what it comes from; tests: how many were made."""

    values: tuple[CraftValue, ...]
    populations: dict[str, Population]
    scatter: dict[str, float]
    findings: tuple[Finding, ...]
    series: tuple[Series, ...]
    tests: int

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        return {
            "crafts": sorted({one.craft for one in self.series}),
            "findings": [asdict(one) for one in self.findings],
            "values": [asdict(one) for one in self.values],
            "population": {
                name: {
                    "value": told(name, one.middle),
                    "stderr": one.middle_stderr * scale(name, one.middle),
                    "spread": one.spread * scale(name, one.middle),
                }
                for name, one in self.populations.items()
            },
            "scatter": self.scatter,
            "tests": self.tests,
            "false_share": FALSE_SHARE,
        }


@dataclass(frozen=True, slots=True)
class _Test:
    series: Series
    change: Change | None
    size: float
    stderr: float
    p: float


def told(quantity: str, value: float) -> float:
    """A value as it is given out: not its logarithm."""
    return math.exp(value) if quantity in RELATIVE else value


def scale(quantity: str, value: float) -> float:
    """What turns a small difference of compared values into one of given values."""
    return math.exp(value) if quantity in RELATIVE else 1.0


def drawn_crafts(fleet: Fleet) -> list[str]:
    """Of at most ``DRAWN`` crafts, the ones with findings certainly among them."""
    ill = dict.fromkeys(one.craft for one in sorted(fleet.findings, key=lambda one: one.p))
    every = dict.fromkeys([*ill, *sorted({one.craft for one in fleet.series})])
    return sorted(list(every)[:DRAWN])


def series_of(recordings: Sequence[Row], fits: dict[str, Row]) -> list[Series]:
    """Each craft's flights in order of time, by quantity; without those that told nothing."""
    by_craft: dict[str, list[tuple[str, Row]]] = {}
    for row in recordings:
        fit = fits.get(row["address"])
        if fit is not None and fit["reason"] is None:
            by_craft.setdefault(row["craft"], []).append((row["begun"], fit))
    found = []
    for craft, flights in sorted(by_craft.items()):
        flights.sort(key=lambda one: (one[0], one[1]["address"]))
        for name in QUANTITIES:
            told_by = [
                (begun, fit[name], fit[f"{name}_stderr"] or 0.0)
                for begun, fit in flights
                if fit[name] is not None and (fit[name] > 0.0 or name not in RELATIVE)
            ]
            if not told_by:
                continue
            begun, values, errors = zip(*told_by, strict=True)
            one, error = np.array(values), np.array(errors)
            if name in RELATIVE:
                one, error = np.log(one), error / one
            found.append(Series(craft, name, begun, one, error))
    return found


def findings_of(recordings: Sequence[Row], fits: dict[str, Row]) -> Fleet:
    """What the fits of a catalogue's recordings tell."""
    series = series_of(recordings, fits)
    tests: list[_Test] = []
    values: list[CraftValue] = []
    populations: dict[str, Population] = {}
    scatter: dict[str, float] = {}
    for name in QUANTITIES:
        of = [one for one in series if one.quantity == name]
        if not of:
            continue
        extra, freedom = scatter_variance([(one.values, one.errors) for one in of])
        scatter[name] = math.sqrt(extra)
        floor = 1e-12 + extra
        levels, variances = [], []
        for one in of:
            variance = one.errors**2 + floor
            change = change_in(one.values, variance, freedom)
            since = 0
            if change is not None:
                tests.append(_Test(one, change, change.size, change.stderr, change.p))
                if change.p < FALSE_SHARE and not change.drift:
                    since = change.flight
            now, error = level(one.values[since:], variance[since:])
            levels.append(now)
            variances.append(error)
        crafts = population(np.array(levels), np.array(variances))
        if crafts is not None:
            populations[name] = crafts
        for k, one in enumerate(of):
            scaled = scale(name, levels[k])
            alone = (told(name, levels[k]), math.sqrt(variances[k]) * scaled)
            shrunk = alone
            if crafts is not None:
                shrunk = (told(name, float(crafts.shrunk[k])), float(crafts.stderr[k]) * scaled)
                away = levels[k] - crafts.middle
                error = math.sqrt(variances[k] + crafts.middle_stderr**2)
                tests.append(_Test(one, None, away, error, float(crafts.p[k])))
            values.append(CraftValue(one.craft, name, len(one.values), *alone, *shrunk))
    believed = discoveries(np.array([one.p for one in tests]), FALSE_SHARE)
    kept = [one for one, true in zip(tests, believed, strict=True) if true]
    findings = tuple(sorted(_grouped(kept), key=lambda one: (one.craft, one.p)))
    return Fleet(tuple(values), populations, scatter, findings, tuple(series), len(tests))


def _grouped(tests: Sequence[_Test]) -> list[Finding]:
    """One finding for what happened to one craft at one time: the clearest quantity leads."""
    by_craft: dict[str, list[_Test]] = {}
    for one in sorted(tests, key=lambda one: (one.p, -abs(one.size) / one.stderr)):
        by_craft.setdefault(one.series.craft, []).append(one)
    found = []
    for rest in by_craft.values():
        while rest:
            first = rest.pop(0)
            along = [one for one in rest if _same_event(first, one)]
            rest[:] = [one for one in rest if not _same_event(first, one)]
            cause = _weaker_rotor(first, along)
            if cause is not None:
                along = [first, *(one for one in along if one is not cause)]
                first = cause
            found.append(_finding(first, along))
    return found


def _same_event(one: _Test, other: _Test) -> bool:
    """Whether what ``other`` tells of the same craft belongs to the clearer ``one``."""
    if one.change is None or other.change is None:
        # A craft that changed is no longer like the others: that is not news.
        both_rotors = {one.series.quantity, other.series.quantity} <= set(ROTORS)
        alike = both_rotors or one.series.quantity == other.series.quantity
        return one.change is other.change or alike
    # What a step explains as well as a drift, at a time when the craft changed, is no other event.
    together = abs(one.change.step - other.change.step) <= TOGETHER
    return together and other.change.drift >= one.change.drift


def _weaker_rotor(first: _Test, along: Sequence[_Test]) -> _Test | None:
    """The rotor whose lift accounts for most of what thrust per mass changed by, if one does."""
    if first.series.quantity != "thrust_per_mass":
        return None
    rotors = [one for one in along if one.series.quantity in ROTORS]
    clearest = max(rotors, key=lambda one: abs(one.size), default=None)
    if clearest is None or _lift(clearest.size) / 4.0 / (100.0 * math.expm1(first.size)) < MOST:
        return None
    return clearest


def _finding(first: _Test, along: Sequence[_Test]) -> Finding:
    series, change = first.series, first.change
    kind = "differs" if change is None else "drift" if change.drift else "change"
    at = 0 if change is None else change.flight
    count = len(series.begun)
    since = series.begun[at]
    name = series.quantity
    size = 100.0 * (math.expm1(first.size) if name in RELATIVE else first.size)
    moved = tuple(dict.fromkeys(o.series.quantity for o in along if o.series.quantity != name))
    amount = f"{WORDS[name]} {size:+.1f} +- {100 * first.stderr:.2g} %"
    when = {
        "differs": "against the other crafts",
        "drift": f"over {count} flights since {since[:10]}",
        "change": f"since {since[:10]} (flight {at + 1} of {count})",
    }[kind]
    text = f"{series.craft}: {amount} {when}: {_likely(first, along)}"
    return Finding(
        series.craft,
        kind,
        name,
        0.01 * size,
        first.stderr,
        first.p,
        since,
        at + 1,
        count,
        moved,
        text,
    )


def _lift(share: float) -> float:
    """By how much, %, a rotor lifts more at the same drive that is asked for ``share`` more than
    the mean of the four, while the others lift as before."""
    beside = share / (0.75 - 0.25 * share)
    return -100.0 * beside / (1.0 + beside)


def _likely(first: _Test, along: Sequence[_Test]) -> str:
    """What usually does that."""
    name, up = first.series.quantity, first.size > 0.0
    if name in ROTORS:
        rotor = int(name[-1])
        across = f"rotor_{(rotor + 1) % 4 + 1}"
        others = {one.series.quantity: one.size for one in along}
        if others.get(across, 0.0) / first.size < -OPPOSITE:
            return "its weight moved, or it is loaded to one side"
        return f"rotor {rotor} (motor or propeller) gives {_lift(first.size):+.1f} % of lift"
    return {
        ("thrust_per_mass", False): "it is heavier, or its rotors are weaker",
        ("thrust_per_mass", True): "it is lighter, or its rotors are stronger",
        ("cell_ohm", True): "the battery ages, or a contact is bad",
        ("cell_ohm", False): "another battery",
        ("shake_dps", True): "a bent axis, or a propeller out of balance",
        ("shake_dps", False): "propellers or axes in better balance",
    }.get((name, up), "its inertia, its arms or its rotors are others")
