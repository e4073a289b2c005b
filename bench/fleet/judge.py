"""Whether each fault was named with craft, quantity and date, and whom a finding wronged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

WITHIN = 5
"""Flights between where a fault began and where it is said to have begun."""
SHOWN_BY = {
    "load": ("thrust_per_mass",),
    "battery": ("cell_ohm",),
    "shift": ("rotor_1", "rotor_2", "rotor_3", "rotor_4"),
    "bent": ("shake_dps",),
}
"""Quantities that a fault moves first. A rotor: its own."""


def named(fate: dict[str, Any], findings: Sequence[dict[str, Any]]) -> int | None:
    """By how many flights the finding that names a fault is off; None where there is none."""
    shown = SHOWN_BY.get(fate["kind"], (f"rotor_{fate['rotor']}",))
    dates = [
        abs(one["flight"] - fate["since"])
        for one in findings
        if one["craft"] == fate["craft"]
        and one["quantity"] in shown
        and one["kind"] in ("change", "drift")
    ]
    return min(dates, default=None)


def table(lines: Sequence[dict[str, Any]]) -> str:
    """What was named by kind of fault, and false findings, in Markdown."""
    judged = [line for line in lines if "error" not in line]
    found: Counter[str] = Counter()
    exact: Counter[str] = Counter()
    asked: Counter[str] = Counter()
    wronged: list[str] = []
    for line in judged:
        ill = {fate["craft"] for fate in line["truth"]}
        for fate in line["truth"]:
            off = named(fate, line["findings"])
            asked[fate["kind"]] += 1
            found[fate["kind"]] += off is not None and off <= WITHIN
            exact[fate["kind"]] += off is not None and off <= 1
        wronged += [
            f"{line['case']}: {one['text']}" for one in line["findings"] if one["craft"] not in ill
        ]
    sound = [line for line in judged if not line["truth"]]
    blamed = sum(bool(line["findings"]) for line in sound)
    tests = sum(line["tests"] for line in sound)
    rows = [f"| {kind} | {asked[kind]} | {found[kind]} | {exact[kind]} |" for kind in sorted(asked)]
    rows.append(f"| all | {asked.total()} | {found.total()} | {exact.total()} |")
    said = [
        f"| fault | hidden | named within {WITHIN} flights | within one |",
        "|---|---|---|---|",
        *rows,
        "",
        f"Fleets without faults: {len(sound)}, {tests} tests; with a false finding: {blamed}.",
        f"Findings about crafts of which nothing became, all fleets: {len(wronged)}.",
        *wronged,
    ]
    if failed := [line for line in lines if "error" in line]:
        said += ["Failed:", *(f"{line['case']}: {line['error']}" for line in failed)]
    return "\n".join(said)
