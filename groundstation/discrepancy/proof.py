"""The proof of a finding: gaps before and after on rows that no fit has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from groundstation.discrepancy.comparison import Comparison, Judged, compare
from groundstation.discrepancy.findings import Findings
from groundstation.identification.runs import Run, hold_out


@dataclass(frozen=True, slots=True)
class Proof:
    """The given and the improved model, on the rows they were fitted to and on others.

    steps: (what joined, the gap on held-out rows with it): the given model, then each
    effect in order.
    """

    train_before: Comparison
    train_after: Comparison
    before: Comparison
    after: Comparison
    steps: tuple[tuple[str, float], ...]


def divide(
    flights: Sequence[Sequence[Run]], held: Sequence[Sequence[Run]]
) -> tuple[list[Run], list[Run], list[Judged]]:
    """(to fit on, held out, the same as parts of whole runs): what is held, or else the last third
    of each recording."""
    if held:
        rest = [run for part in held for run in part]
        fit_on = [run for part in flights for run in part]
        return fit_on, rest, [Judged(run, 0, len(run)) for run in rest]
    fit_on, rest, judged = [], [], []
    for part in flights:
        first, last = hold_out(part)
        fit_on += first
        rest += last
        for piece in last:
            whole = max((run for run in part if run.start_s <= piece.start_s), key=_start)
            row = round((piece.start_s - whole.start_s) / whole.period_s)
            judged.append(Judged(whole, row, row + len(piece)))
    return fit_on, rest, judged


def _start(run: Run) -> float:
    return run.start_s


def prove(findings: Findings, train: Comparison, judge_on: Sequence[Judged]) -> Proof:
    """Judge the model given, and each step to the improved one.

    train: the model given on the rows that were fitted; the noise floor is learnt on them, and
    is the same before and after.
    """
    before = compare(judge_on, train.model, train.black_box)
    after = before.with_model(findings.model)
    steps = [("given model", before.gap)]
    for number, found in enumerate(findings.effects, 1):
        last = number == len(findings.effects)
        joined = after if last else before.with_model(found.model)
        steps.append((found.name, joined.beside(before)))
    return Proof(train, train.with_model(findings.model), before, after, tuple(steps))
