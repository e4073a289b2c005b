"""Sections of the fleet's page: before and after, effects by craft, what to fly next, what flights
tell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from groundstation.fleet.before_after import Shift
from groundstation.fleet.certainty import NOTHING, TOLD, Expectation
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
                *(one.quantity, 100 * one.size, 100 * one.stderr, one.crafts, one.with_it, one.p),
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


def add_expected(page: Page, expected: Mapping[str, Expectation], fleet: Fleet) -> None:
    """How well each craft's flights tell the constants, before a fit and after it."""
    if not expected:
        return
    known = {(one.craft, one.quantity): 100.0 * one.stderr / abs(one.value) for one in fleet.values}
    page.heading("What the flights tell")
    page.table(
        ("craft", "flights", "worth a fit", *(f"{name}, %" for name in TOLD)),
        [
            (
                *(craft, one.flights, one.worth),
                *(_both(one.errors[name], known.get((craft, name))) for name in TOLD),
            )
            for craft, one in list(expected.items())[:LISTED]
        ],
        "Relative standard errors of all flights of a craft together: expected from their"
        " Jacobians, and after the arrow what the fits and the scatter from flight to flight left."
        " motor_pace: how fast the motors answer, of which no value is kept. Worth a fit: tells c0"
        " and c1 well enough for a design." + _of_many(len(expected)),
    )


def _of_many(count: int) -> str:
    return f" The first {LISTED} of {count} crafts; --json has all." if count > LISTED else ""


def _both(expected: float, known: float | None) -> str:
    before = "nothing" if expected >= NOTHING else f"{100.0 * expected:.2g}"
    return before if known is None else f"{before} → {known:.2g}"


def to_fly(
    fleet: Fleet, searched: Mapping[str, Row], expected: Mapping[str, Expectation]
) -> dict[str, list[str]]:
    """Craft -> what to fly next, because its flights do not tell: manoeuvre, and for what.

    A craft's fits say so, or else what its flights are expected to tell.
    """
    from groundstation.control.uncertainty import MOST_STDERR, RECORD

    found: dict[str, list[str]] = {}
    crafts = {one.craft for one in fleet.series}
    known = {(one.craft, one.quantity): one for one in fleet.values}
    for craft in sorted(crafts | expected.keys()):
        for name, most in MOST_STDERR.items():
            value = known.get((craft, name))
            if craft not in crafts:
                untold = expected[craft].errors[name] > most
            else:
                untold = value is None or value.stderr > most * abs(value.value)
            if untold:
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
