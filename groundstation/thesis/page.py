"""The page and the JSON of what was made."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from groundstation.report.page import Page
from groundstation.thesis.entry import Done
from groundstation.thesis.printed import WITHOUT

TITLE = "The thesis, repeated"
WHOSE = (
    "Modeling, Identification and Simulation of a Quadrotor Using Real-Time Flight Data (M.Sc."
    " thesis, Istanbul Technical University, May 2015, on a Crazyflie 1.0)"
)
INTRODUCTION = (
    "Every table and figure of the thesis that has a counterpart, in printed order, made from the"
    " stand-in, whose true constants are known, and from the 25 printed rows of Figure 5.7; the"
    " thesis's own recordings are not published. So numbers are not expected to agree with the"
    " printed ones: compared is what each procedure finds, and whether it is the truth."
)
OUTCOME = "What came out"
NOTHING, COMMANDS = "Without a counterpart", "Commands"
COMMANDS_TEXT = (
    "All, in order, for a folder with the files that groundstation thesis puts there first"
    " (excerpt.csv, hand.toml, printed.toml); commands.sh there runs them anew."
)


def page(done: Sequence[Done], seconds: float) -> Page:
    """One page, a section for each number."""
    made = Page(TITLE, f"{len(done)} entries, made in {seconds:.0f} s")
    made.verdict(
        f"{WHOSE}: {len(done)} of its tables and figures made again, {len(WITHOUT)} have no"
        " counterpart.",
        "neutral",
    )
    made.next_step("see under each number what was done, and the commands that do it again.")
    made.text(INTRODUCTION)
    made.heading(OUTCOME)
    made.table(
        ["number", "what it is", "what came out"],
        [
            (
                one.entry.number.replace(" ", "\u00a0"),  # in one line
                one.entry.title,
                _first_sentence(one.made.says),
            )
            for one in done
        ],
    )
    for one in done:
        made.heading(one.entry.number)
        made.text(f"{one.entry.title}.")
        for table in one.made.tables:
            made.table(table.head, table.rows, table.caption)
        for drawn in one.made.figures:
            made.figure(drawn, f"{one.entry.number}: {one.entry.title}")
        made.text(one.made.says)
        if one.commands:
            made.code(one.commands)
    made.heading(NOTHING)
    made.table(["number", "what it is"], WITHOUT)
    made.heading(COMMANDS)
    made.text(COMMANDS_TEXT)
    made.code(_all_commands(done))
    return made


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=[.]) (?=[A-Z])", text)[0]


def as_json(done: Sequence[Done], seconds: float) -> dict[str, Any]:
    """For programs."""
    return {
        "entries": [
            {
                "number": one.entry.number,
                "title": one.entry.title,
                "says": one.made.says,
                "tables": [table.as_dict() for table in one.made.tables],
                "figures": len(one.made.figures),
                "commands": list(one.commands),
                "from_nothing": list(one.chain),
            }
            for one in done
        ],
        "without": [{"number": number, "why": why} for number, why in WITHOUT],
        "seconds": round(seconds, 1),
    }


def _all_commands(done: Sequence[Done]) -> list[str]:
    found: list[str] = []
    for one in done:
        found += [line for line in one.chain if line not in found]
    return found
