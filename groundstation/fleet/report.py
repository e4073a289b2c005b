"""A fleet on one page: what to do first, crafts by quantities, and each finding as one sees it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundstation.fleet.engine import Row
from groundstation.fleet.findings import (
    FALSE_SHARE,
    Finding,
    Fleet,
    Series,
    Shift,
    drawn_crafts,
    scale,
    told,
)
from groundstation.fleet.fit import QUANTITIES, RELATIVE, WORDS
from groundstation.fleet.index import UNFIT
from groundstation.report.page import (
    BAD,
    MEASURED,
    MODELLED,
    NEUTRAL,
    Cell,
    Page,
    figure,
    legend_above,
)
from groundstation.text import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Sections of the fleet's page: before and after, effects by craft, what to fly next.


LISTED = 50


def add_shifts(page: Page, date: str, shifts: Sequence[Shift]) -> None:
    """What is otherwise since ``date``, over all crafts."""
    page.heading(f"Before and after {date}")
    if not shifts:
        page.text("No craft has two fitted flights on either side.")
        return
    rows: list[tuple[Cell, ...]] = []
    for one in shifts:
        change, believed = (100 * one.size, 100 * one.stderr), "yes" if one.believed else "no"
        rows.append((one.quantity, *change, one.crafts, one.with_it, one.p, believed))
    page.table(
        ("quantity", "change, %", "+-", "crafts", "that way", "chance", "believed"),
        rows,
        "Median of the crafts that flew on both sides; their own spread counts.",
    )


def add_effects(page: Page, searched: Mapping[str, Row]) -> None:
    """Who has what, how much."""
    told = {craft: row for craft, row in searched.items() if row["reason"] is None}
    if not searched:
        return
    page.heading("Effects")
    counts = Counter(name for row in told.values() for name in row["effects"])
    for name, count in counts.most_common():
        page.text(f"{name}: in {count} of {len(told)} crafts")
    sizes = {craft: _sizes(row) for craft, row in told.items()}
    columns = sorted(
        {name for one in sizes.values() for name in one},
        key=lambda c: (-counts[c.split(".")[0]], c),
    )
    page.table(
        ("craft", "gap before", "after", *columns),
        [
            (craft, row["gap_before"], row["gap_after"], *(sizes[craft].get(c) for c in columns))
            for craft, row in told.items()
        ],
        "What each craft's model was missing, and the gap on flights that no fit saw (1 is noise).",
    )
    changed = [f"{craft}: {line}" for craft, row in told.items() for line in row["changed"]]
    if changed:
        page.text("Constants that are not those of the model it was held against:")
        page.bullets(changed[:LISTED])
    page.bullets(f"{c}: {row['reason']}" for c, row in searched.items() if row["reason"])


def to_fly(fleet: Fleet, searched: Mapping[str, Row]) -> dict[str, list[str]]:
    """Craft -> what to fly next, because its fits do not tell: manoeuvre, and for what."""
    from groundstation.control.design import RECORD
    from groundstation.dynamics.meanings import CONSTANT, MOST_STDERR

    found: dict[str, list[str]] = {}
    known = {(one.craft, one.quantity): one for one in fleet.values}
    for craft in sorted({one.craft for one in fleet.series}):
        for name in CONSTANT.values():
            value = known.get((craft, name))
            if value is None or value.stderr > MOST_STDERR * abs(value.value):
                found.setdefault(craft, []).append(f"{RECORD[name]} (for {name})")
    for craft, row in searched.items():
        by_manoeuvre: dict[str, list[str]] = {}
        for line in row["to_fly"] or ():
            name, _, manoeuvre = line.partition(": ")
            by_manoeuvre.setdefault(manoeuvre, []).append(name)
        for manoeuvre, names in by_manoeuvre.items():
            found.setdefault(craft, []).append(f"{manoeuvre} (for {', '.join(names)})")
    return found


def add_to_fly(page: Page, flights: Mapping[str, Sequence[str]]) -> None:
    """What to fly next, crafts with the same need together."""
    if not flights:
        return
    page.heading("To fly next")
    crafts: dict[str, list[str]] = {}
    for craft, lines in flights.items():
        for line in lines:
            crafts.setdefault(line, []).append(craft)
    page.table(
        ("manoeuvre", "crafts"),
        [(line, ", ".join(of)) for line, of in crafts.items()],
        "What their flights so far cannot tell.",
    )


def _sizes(row: Row) -> dict[str, str]:
    """Parameter with its unit -> value and standard error."""
    found = {}
    for name, value, stderr, unit in zip(
        *(row[key] for key in ("parameters", "values", "stderrs", "units")), strict=True
    ):
        spread = "" if stderr is None else f" +- {stderr:.2g}"
        found[f"{name}, {unit}" if unit else name] = f"{value:.4g}{spread}"
    return found


DRAWN = 12
"""Findings with a figure of their own, the clearest first."""
CLEAR_Z = 4.0
"""Where the colours of the map end."""


@dataclass(frozen=True, slots=True)
class More:
    """What else a catalogue may hold: table ``effects``, what to fly next, and shifts since
    ``date``."""

    effects: Mapping[str, Row]
    to_fly: Mapping[str, Sequence[str]]
    date: str | None = None
    shifts: Sequence[Shift] = ()


def report(
    fleet: Fleet, recordings: Sequence[Row], fits: dict[str, Row], name: str, more: More
) -> Page:
    """The page of a catalogue called ``name``."""
    crafts = sorted({one.craft for one in fleet.series})
    fitted = sum(1 for one in fits.values() if one["reason"] is None)
    tried = f"{counted(len(crafts), 'craft')}, {counted(fitted, 'flight')} fitted"
    page = Page(f"Fleet {name}", f"{counted(len(recordings), 'recording')} of {tried}")
    _verdict(page, fleet, len(crafts), tried)
    found = fleet.findings
    if more.date is not None:
        add_shifts(page, more.date, more.shifts)
    add_effects(page, more.effects)
    add_to_fly(page, more.to_fly)
    drawn = drawn_crafts(fleet)
    of_many = ""
    if len(drawn) < len(crafts):
        of_many = (
            f" {len(drawn)} of {len(crafts)} crafts, those with findings first; --json has all."
        )
    if fleet.populations:
        page.heading("Crafts among crafts")
        page.figure(
            _map(fleet, drawn),
            "How far each craft is from the middle of the fleet, in standard deviations of crafts"
            f" and of its own uncertainty.{of_many}",
        )
    page.heading("Values")
    page.table(
        ("craft", "quantity", "flights", "value", "+-", "with the fleet", "+-"),
        [
            (v.craft, v.quantity, v.flights, v.value, v.stderr, v.shrunk, v.shrunk_stderr)
            for v in fleet.values
            if v.craft in drawn
        ],
        "Present value of each craft, alone, and with what the others say of a craft like them:"
        " where few flights tell little, the fleet's middle counts. rotor_1..4: share by which a"
        f" rotor is driven more than the mean.{of_many}",
    )
    if found:
        page.heading("Findings")
    by_key = {(one.craft, one.quantity): one for one in fleet.series}
    for one in sorted(found, key=lambda f: f.p)[:DRAWN]:
        page.figure(_drawn(by_key[one.craft, one.quantity], one, fleet), one.text)
    _set_aside(page, recordings, fits)
    return page


def _verdict(page: Page, fleet: Fleet, crafts: int, tried: str) -> None:
    """What came of the tests, and what to do."""
    found = fleet.findings
    if found:
        ill = len({one.craft for one in found})
        page.verdict(f"{ill} of {crafts} crafts changed, or differ from the others.", "bad")
        page.next_step(
            "check on the craft what is named; mend it, fly again, and index: what was mended is"
            " found to have changed back."
        )
        page.bullets(one.text for one in found)
    elif fleet.tests:
        page.verdict(f"No craft changed or differs, of {crafts}, by {fleet.tests} tests.", "good")
        page.next_step("nothing to mend: index what is flown from now on.")
    else:
        page.verdict(f"Nothing could be tested yet: {tried}.", "neutral")
        page.next_step(
            "record and fit more: a craft is compared with itself from some flights before and"
            " after, and with others from four crafts on."
        )
    if fleet.tests:
        page.text(
            f"{fleet.tests} tests were made; of what is named at most {100 * FALSE_SHARE:.0f} % is"
            " expected to be chance."
        )


def _map(fleet: Fleet, crafts: Sequence[str]) -> Figure:
    names = [one for one in QUANTITIES if one in fleet.populations]
    z = np.full((len(crafts), len(names)), np.nan)
    for value in fleet.values:
        crowd = fleet.populations.get(value.quantity)
        if crowd is None or value.craft not in crafts:
            continue
        factor = scale(value.quantity, crowd.middle)
        spread = np.hypot(crowd.spread * factor, value.stderr)
        away = value.value - told(value.quantity, crowd.middle)
        z[crafts.index(value.craft), names.index(value.quantity)] = away / max(spread, 1e-300)
    made, (axes,) = figure(9.0, 1.2 + 0.26 * len(crafts))
    image = axes.imshow(z, aspect="auto", cmap="coolwarm", vmin=-CLEAR_Z, vmax=CLEAR_Z)
    axes.set_xticks(range(len(names)), names, rotation=30, ha="right")
    axes.set_yticks(range(len(crafts)), crafts)
    axes.grid(visible=False)
    made.colorbar(image, ax=axes, label="standard deviations")
    return made


def _drawn(series: Series, finding: Finding, fleet: Fleet) -> Figure:
    name, count = series.quantity, len(series.values)
    values = np.array([told(name, one) for one in series.values])
    scatter = np.hypot(series.errors, fleet.scatter[name])
    errors = scatter * np.array([scale(name, one) for one in series.values])
    made, (axes,) = figure(9.0, 2.8)
    flights = np.arange(1, count + 1)
    axes.errorbar(
        flights, values, errors, fmt="o", ms=3.5, lw=0.8, color=MEASURED, label="each flight"
    )
    crowd = fleet.populations.get(name)
    if crowd is not None:
        low, high = (told(name, crowd.middle + sign * crowd.spread) for sign in (-1.0, 1.0))
        axes.axhspan(low, high, color=NEUTRAL, alpha=0.2, lw=0, label="two thirds of the crafts")
    if finding.kind == "change":
        at = finding.flight - 1
        axes.axvline(at + 0.5, color=BAD, lw=1.0, ls="--", label="since then")
        for part in (slice(0, at), slice(at, count)):
            middle = told(name, float(np.median(series.values[part])))
            axes.plot(flights[part], np.full(len(flights[part]), middle), color=MODELLED)
    elif finding.kind == "drift":
        line = np.polyval(np.polyfit(flights, values, 1), flights)
        axes.plot(flights, line, color=MODELLED, label="drift")
    axes.set_title(f"{series.craft}: {WORDS[name]}")
    axes.set_xlabel("flight, in order of time")
    axes.set_ylabel(name + (" (share)" if name not in RELATIVE else ""))
    legend_above(axes)
    return made


def _set_aside(page: Page, recordings: Sequence[Row], fits: dict[str, Row]) -> None:
    """What did not count, and why."""
    rows = [
        (one["address"], one["state"], one["reason"]) for one in recordings if one["state"] in UNFIT
    ]
    rows += [
        (address, "not fitted", one["reason"])
        for address, one in sorted(fits.items())
        if one["reason"] is not None
    ]
    if rows:
        page.heading("Set aside")
        more = f" The first {LISTED} of {len(rows)}." if len(rows) > LISTED else ""
        page.table(("recording", "state", "reason"), rows[:LISTED], "What counts nowhere." + more)
