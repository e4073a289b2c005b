"""The table as a page of the documents: every fault, and what noticed it."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from bench.mutants.run import Outcome
from bench.mutants.table import FAULTS
from groundstation import __version__

_HEAD = """\
# Faults that the tests notice

`make mutants` puts faults into the program, one at a time and in memory only, and runs the few
tests of the short suite that should notice. A fault that survives fails the command, as does a
test that fails without one. The table is in `bench/mutants`; a row there says which text of which
file is replaced by what. "Noticed by" says where, and how many tests of those that ran.
"""


def write_page(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Write the page, with what these runs found."""
    found = {outcome.fault.name: outcome for outcome in outcomes if outcome.fault is not None}
    parts = [_HEAD]
    for group, faults in FAULTS.items():
        rows = [_row(found[fault.name]) for fault in faults if fault.name in found]
        head = ["| fault | what it breaks | noticed by | s |", "|---|---|---|---|"]
        parts.append("\n".join([f"## {group.capitalize()}", "", *head, *rows]) + "\n")
    parts.append(_foot(list(found.values())))
    path.write_text("\n".join(parts))


def _row(outcome: Outcome) -> str:
    fault = outcome.fault
    assert fault is not None
    ran = len(outcome.failed) + outcome.passed
    files = ", ".join(sorted({f"`{test.partition('::')[0]}`" for test in outcome.failed}))
    noticed = f"{files}, {len(outcome.failed)} of {ran}" if outcome.is_good else "**nothing**"
    return f"| {fault.name} | {fault.breaks} | {noticed} | {outcome.seconds:.1f} |"


def _foot(outcomes: Sequence[Outcome]) -> str:
    noticed = sum(outcome.is_good for outcome in outcomes)
    today = datetime.now(UTC).strftime("%Y-%m-%d")
    return (
        f"{noticed} of {len(outcomes)} were noticed: `make mutants"
        ' ARGS="--page bench/mutants/RESULTS.md"`,'
        f" groundstation {__version__}, {today}. Seconds are wall time, with as many runs at a time"
        " as there are processors.\n"
    )
