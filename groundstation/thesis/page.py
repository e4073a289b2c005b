"""The page, the JSON and the Markdown of what was made."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from groundstation.report.page import Cell, Page
from groundstation.thesis.entry import Done, Table
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


def markdown(done: Sequence[Done]) -> str:
    """The tables and what is said of each number, with the commands behind it."""
    parts = [
        f"# {TITLE}",
        "`groundstation thesis -o FOLDER` leaves this page as `thesis.md`, beside one with the"
        " figures. Every number comes from the commands named under it, which are listed at the"
        " end; nothing is typed in but what is printed.",
        INTRODUCTION,
    ]
    numbers = {line: number for number, line in enumerate(_all_commands(done), 1)}
    for one in done:
        parts.append(f"## {one.entry.number}: {one.entry.title}")
        parts += [_table(table) for table in one.made.tables]
        parts.append(one.made.says)
        if one.chain:
            made_by = ", ".join(str(numbers[line]) for line in one.commands)
            needs = [str(numbers[line]) for line in one.chain if line not in one.commands]
            parts.append(
                f"Commands {made_by}" + (f" (after {', '.join(needs)})." * bool(needs) or ".")
            )
    parts.append(f"## {NOTHING}")
    parts.append(_table(Table(["number", "what it is"], WITHOUT)))
    parts.append(f"## {COMMANDS}")
    parts.append(COMMANDS_TEXT)
    listed = "\n".join(f"{number:2}  {line}" for line, number in numbers.items())
    parts.append(f"```text\n{listed}\n```")
    return "\n\n".join(parts) + "\n"


def _all_commands(done: Sequence[Done]) -> list[str]:
    found: list[str] = []
    for one in done:
        found += [line for line in one.chain if line not in found]
    return found


def _table(table: Table) -> str:
    lines = ["| " + " | ".join(table.head) + " |", "|" + "---|" * len(table.head)]
    lines += ["| " + " | ".join(_cell(cell) for cell in row) + " |" for row in table.rows]
    return "\n".join(lines) + (f"\n\n{table.caption}" if table.caption else "")


def _cell(cell: Cell) -> str:
    if cell is None:
        return ""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)
