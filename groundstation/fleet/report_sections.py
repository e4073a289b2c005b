"""Sections of the fleet's page: before and after, effects by craft, what to fly next."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from groundstation.fleet.before_after import Shift
from groundstation.fleet.findings import Fleet
from groundstation.fleet.parts import Row
from groundstation.report.page import Page

LISTED = 50


def add_shifts(page: Page, date: str, shifts: Sequence[Shift]) -> None:
    """What is otherwise since ``date``, over all crafts."""
    page.heading(f"Before and after {date}")
    if not shifts:
        page.text("No craft has two fitted flights on either side.")
        return
    page.table(
        ("quantity", "change, %", "+-", "crafts", "that way", "chance", "believed"),
        [
            (
                one.quantity,
                100 * one.size,
                100 * one.stderr,
                one.crafts,
                one.with_it,
                one.p,
                "yes" if one.believed else "no",
            )
            for one in shifts
        ],
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
        for manoeuvre, names in _by_manoeuvre(row["to_fly"] or ()).items():
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


def _by_manoeuvre(lines: Iterable[str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in lines:
        name, _, manoeuvre = line.partition(": ")
        found.setdefault(manoeuvre, []).append(name)
    return found


def _sizes(row: Row) -> dict[str, str]:
    """Parameter with its unit -> value and standard error."""
    found = {}
    for name, value, stderr, unit in zip(
        *(row[key] for key in ("parameters", "values", "stderrs", "units")), strict=True
    ):
        spread = "" if stderr is None else f" +- {stderr:.2g}"
        found[f"{name}, {unit}" if unit else name] = f"{value:.4g}{spread}"
    return found
