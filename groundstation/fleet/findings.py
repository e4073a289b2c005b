"""What a fleet's fits tell: who differs, what changed since when, whether it helped."""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.fleet.engine import Row
from groundstation.fleet.fit import QUANTITIES, RELATIVE, ROTORS, WORDS
from groundstation.telemetry.arrays import Array

# Crafts among crafts, flight after flight: how much flights scatter, what changed, who differs.
#
# A value of flight j of craft k is  craft_k(j) + scatter + error, the error with the fit's
# standard error, the scatter (weather, battery, place) alike for all crafts. The scatter comes
# from the differences of neighbouring flights, which no change of a craft can blow up (its
# median); so do the spread of crafts and their middle (DerSimonian and Laird's model, medians in
# place of moments).


LEAST_PART = 3
"""Flights before and after a change: the middle of three is not one wild flight."""
LEAST_CRAFTS = 4
MEDIAN_CHI2 = 0.4549364
"""Median of a squared standard normal."""
EFFICIENCY = 0.37
"""Of a variance by a median: so much of the degrees of freedom count."""
POSSIBLE = 0.1
"""Chance beyond which no test is ever believed, so that its exact value is not worth computing."""
ALMOST = 0.8
"""Share of the clearest place's z at which another place of the change is possible."""
MEDIAN_STDERR = 1.2533
"""Standard error of a median over that of a mean, of many normal values."""


@dataclass(frozen=True, slots=True)
class Change:
    """flight: index of the first flight after it. step: the same of the likeliest step, of a drift
    too. size, stderr: after less before; of a drift, from the first flight to the last. p: how
    often chance does as much, anywhere in this series."""

    flight: int
    step: int
    size: float
    stderr: float
    drift: bool
    p: float


def scatter_variance(series: Sequence[tuple[Array, Array]]) -> tuple[float, float]:
    """(variance from flight to flight beyond the errors, degrees of freedom it is known to).

    series: (values (n,), standard errors (n,)) of each craft, in order of time.
    """
    steps = np.concatenate([np.diff(values) for values, _ in series] or [np.zeros(0)])
    known = [errors[1:] ** 2 + errors[:-1] ** 2 for _, errors in series]
    noise = np.concatenate(known or [np.zeros(0)])
    return 0.5 * excess_variance(steps, noise), max(1.0, EFFICIENCY * len(steps))


def excess_variance(deviations: Array, noise: Array) -> float:
    """The variance that must be added to ``noise`` for squared deviations to have the median of
    normal ones; never negative."""
    from scipy.optimize import brentq

    if len(deviations) == 0:
        return 0.0
    squares = deviations**2

    def beyond(extra: float) -> float:
        return float(np.median(squares / np.maximum(noise + extra, 1e-300))) - MEDIAN_CHI2

    most = float(squares.max()) / MEDIAN_CHI2
    if most == 0.0 or beyond(0.0) <= 0.0:
        return 0.0
    return float(brentq(beyond, 0.0, most))


def change_in(values: Array, variance: Array, freedom: float) -> Change | None:
    """The likeliest single change of a series (n,), however unlikely; None where it is too short.

    variance: (n,), scatter included. Means and medians before and after must both differ; for a
    drift the slope must be there and the order of the values (Mann and Kendall's test) as well, so
    that one wild flight is neither.
    """
    n = len(values)
    places = np.arange(LEAST_PART, n - LEAST_PART + 1)
    if len(places) < 1:
        return None
    sizes, stderrs, z, costs = _steps(values, variance, places)
    # Medians hardly say where: of the places that they allow, the means choose.
    allowed = np.abs(z) >= ALMOST * np.abs(z).max()
    best = int(np.argmax(np.where(allowed, np.abs(sizes) / stderrs, -1.0)))
    size, stderr = float(sizes[best]), float(stderrs[best])
    p = min(1.0, len(places) * _either_way(float(z[best]), freedom))
    slope, slope_stderr, drift_cost = _trend(values, variance)
    if drift_cost + 2.0 < float(costs[best]) + math.log(n):  # a step has its place besides
        span = float(n - 1)
        p = _either_way(slope / slope_stderr, freedom)
        if p < POSSIBLE:
            p = max(p, _order(values))
        return Change(0, int(places[best]), slope * span, slope_stderr * span, True, p)
    return Change(int(places[best]), int(places[best]), size, stderr, False, p)


def level(values: Array, variance: Array) -> tuple[float, float]:
    """Weighted mean and its variance."""
    weight = 1.0 / variance
    return float((weight * values).sum() / weight.sum()), float(1.0 / weight.sum())


@dataclass(frozen=True, slots=True)
class Population:
    """middle, its standard error, and spread (standard deviation) of crafts; p (k,): how often a
    craft of that population is as far out; shrunk, stderr (k,): the crafts' values given it, moved
    by one standard error of their own at most, for a craft of another kind owes the others nothing
    (Efron and Morris 1972)."""

    middle: float
    middle_stderr: float
    spread: float
    p: Array
    shrunk: Array
    stderr: Array


def population(levels: Array, variance: Array) -> Population | None:
    """Of crafts' levels (k,) with their variances; None for fewer than ``LEAST_CRAFTS``."""
    from scipy.stats import t

    count = len(levels)
    if count < LEAST_CRAFTS:
        return None
    middle = float(np.median(levels))
    between = excess_variance(levels - middle, variance)
    total = variance + between
    middle_variance = MEDIAN_STDERR**2 / float((1.0 / total).sum())
    z = (levels - middle) / np.sqrt(total + middle_variance)
    p = 2.0 * t.sf(np.abs(z), max(1.0, EFFICIENCY * (count - 1)))
    share = between / total
    own = np.sqrt(variance)
    shrunk = levels + np.clip((share - 1.0) * (levels - middle), -own, own)
    stderr = np.sqrt(share * variance + (1.0 - share) ** 2 * middle_variance)
    middles = middle, math.sqrt(middle_variance), math.sqrt(between)
    return Population(*middles, np.asarray(p), np.asarray(shrunk), np.asarray(stderr))


def discoveries(p: Array, share: float) -> NDArray[np.bool_]:
    """Which of the tests (m,) to believe, so that at most ``share`` of those believed are chance
    (Benjamini and Hochberg 1995; holds for tests that depend on each other positively)."""
    from scipy.stats import false_discovery_control

    return np.asarray(false_discovery_control(p) <= share) if len(p) else np.zeros(0, np.bool_)


def _steps(
    values: Array, variance: Array, places: NDArray[np.int64]
) -> tuple[Array, Array, Array, Array]:
    """Of a step at each place: size, standard error, the weaker of two z (of means and of medians,
    0 where they disagree on its sign), and the cost of the fit. By sums that grow along the series:
    large fleets have many."""
    values = values - values.mean()  # the sums' digits are for what differs
    weight = 1.0 / variance
    w, wv, wvv = (np.concatenate([[0.0], np.cumsum(weight * values**power)]) for power in (0, 1, 2))
    before = wv[places] / w[places]
    after = (wv[-1] - wv[places]) / (w[-1] - w[places])
    sizes = after - before
    stderrs = np.sqrt(1.0 / w[places] + 1.0 / (w[-1] - w[places]))
    middle = _medians(values[::-1])[len(values) - places] - _medians(values)[places]
    means, robust = sizes / stderrs, middle / (MEDIAN_STDERR * stderrs)
    z = np.where(means * robust > 0.0, np.minimum(np.abs(means), np.abs(robust)), 0.0)
    costs = wvv[-1] - w[places] * before**2 - (w[-1] - w[places]) * after**2 + 2.0
    return sizes, stderrs, z, costs


def _medians(values: Array) -> Array:
    """Of the first k values, for every k; nothing for none."""
    ordered: list[float] = []
    found = np.full(len(values) + 1, np.nan)
    for k, value in enumerate(values.tolist(), 1):
        insort(ordered, value)
        found[k] = 0.5 * (ordered[(k - 1) // 2] + ordered[k // 2])
    return found


def _either_way(z: float, freedom: float) -> float:
    """How often Student's t is as far from 0."""
    from scipy.special import stdtr

    return 2.0 * float(stdtr(freedom, -abs(z)))


def _trend(values: Array, variance: Array) -> tuple[float, float, float]:
    """Slope per flight, its standard error, and the cost of the straight line."""
    weight = 1.0 / variance
    place = np.arange(len(values)) - level(np.arange(len(values), dtype=np.float64), variance)[0]
    middle = level(values, variance)[0]
    power = float((weight * place**2).sum())
    slope = float((weight * place * (values - middle)).sum()) / power
    cost = float((weight * (values - middle - slope * place) ** 2).sum())
    return slope, 1.0 / math.sqrt(power), cost


def _order(values: Array) -> float:
    """How often chance puts values in such an order: mostly rising, or mostly falling (Mann and
    Kendall; exact for short series)."""
    from scipy.stats import kendalltau

    return float(kendalltau(np.arange(len(values)), values).pvalue)


# What a fleet's fits tell: crafts' values, what changed since when, who differs, in words.


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
    told = 0.01 * size, first.stderr, first.p
    return Finding(series.craft, kind, name, *told, since, at + 1, count, moved, text)


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


# Did it help? All crafts before and after a date: a new propeller, firmware, battery.


LEAST_FLIGHTS = 2
"""Of a craft on either side."""
LEAST_PAIR = 2
"""The median of so few is their mean."""


@dataclass(frozen=True, slots=True)
class Shift:
    """A quantity after the date less before it, median of the crafts. size, stderr: a share where
    the quantity is one, otherwise in its unit; crafts: that flew on both sides; with_it: how many
    of them moved that way; p: how often chance does as much; believed: beyond the stated rate."""

    quantity: str
    size: float
    stderr: float
    crafts: int
    with_it: int
    p: float
    believed: bool

    @property
    def text(self) -> str:
        """In words."""
        sure = "" if self.believed else ": within what chance does"
        return (
            f"{WORDS[self.quantity]} {100 * self.size:+.1f} +- {100 * self.stderr:.2g} %"
            f" ({self.with_it} of {self.crafts} crafts that way){sure}"
        )


def parse_date(text: str) -> str:
    """An ISO date or time (UTC unless it says otherwise) as catalogues hold it.

    Raises BadInputError.
    """
    try:
        when = datetime.fromisoformat(text)
    except ValueError as error:
        raise BadInputError(
            f"--compare-before {text}: not a date; for example 2026-05-01 or 2026-05-01T12:00"
        ) from error
    when = when.replace(tzinfo=UTC) if when.tzinfo is None else when.astimezone(UTC)
    return when.isoformat(timespec="seconds")


def shifts(series: Sequence[Series], date: str) -> tuple[Shift, ...]:
    """Of each quantity that some craft has flown before ``date`` and since.

    Crafts need not all shift alike: their own spread of shifts counts. A median, for one craft that
    crashed in between says nothing of the change that all were given.
    """
    found = []
    for name in QUANTITIES:
        of = [one for one in series if one.quantity == name]
        extra, freedom = scatter_variance([(one.values, one.errors) for one in of])
        moved, variance = [], []
        for one in of:
            old = np.array([begun < date for begun in one.begun])
            if min(old.sum(), (~old).sum()) < LEAST_FLIGHTS:
                continue
            each = one.errors**2 + extra + 1e-12
            (before, u), (after, v) = (level(one.values[k], each[k]) for k in (old, ~old))
            moved.append(after - before)
            variance.append(u + v)
        if moved:
            found.append(_shift(name, np.array(moved), np.array(variance), freedom))
    believed = discoveries(np.array([one[-1] for one in found]), FALSE_SHARE)
    return tuple(
        Shift(*told, believed=bool(true)) for told, true in zip(found, believed, strict=True)
    )


def _shift(
    name: str, moved: np.ndarray, variance: np.ndarray, freedom: float
) -> tuple[str, float, float, int, int, float]:
    from scipy.stats import t

    between = 0.0
    if len(moved) >= LEAST_CRAFTS:
        between = excess_variance(moved - np.median(moved), variance)
        freedom = min(freedom, len(moved) - 1.0)
    size = float(np.median(moved))
    stderr = math.sqrt(level(moved, variance + between)[1])
    if len(moved) > LEAST_PAIR:
        stderr *= MEDIAN_STDERR
    p = 2.0 * float(t.sf(abs(size) / stderr, freedom))
    with_it = int((np.sign(moved) == np.sign(size)).sum())
    share = math.expm1(size) if name in RELATIVE else size
    return name, share, stderr, len(moved), with_it, p
