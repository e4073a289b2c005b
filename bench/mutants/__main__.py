"""``python -m bench.mutants``: put every fault in, one at a time, and say which nobody noticed."""

from __future__ import annotations

import argparse
import os
import sys

from bench.mutants.fault import Fault
from bench.mutants.run import Outcome, run_all
from bench.mutants.table import FAULTS

EXAMPLES = """examples:
  make mutants
  make mutants ARGS="lease-token page-token"
"""


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bench.mutants",
        description="Put in faults that the short suite must notice, one at a time.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="these faults only")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    arguments = parser.parse_args()
    known = {fault.name: fault for group in FAULTS.values() for fault in group}
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        parser.error(f"no fault is called {', '.join(unknown)}; there are {', '.join(known)}")
    chosen = [known[name] for name in arguments.names or known]
    untrue = [words for fault in chosen if (words := fault.untrue())]
    if untrue:
        print("\n".join(untrue), file=sys.stderr)
        return 1
    outcomes = []
    for outcome in run_all(_runs(arguments.names), arguments.jobs):
        outcomes.append(outcome)
        _report(outcome)
    return _conclude(outcomes)


def _runs(names: list[str]) -> list[tuple[Fault | None, tuple[str, ...]]]:
    """Every fault with its tests; before those of a group none, with all of them: they pass."""
    found: list[tuple[Fault | None, tuple[str, ...]]] = []
    for group in FAULTS.values():
        faults = [fault for fault in group if not names or fault.name in names]
        if faults:
            found.append((None, tuple(dict.fromkeys(test for one in faults for test in one.tests))))
        found += [(fault, fault.tests) for fault in faults]
    return found


def _report(outcome: Outcome) -> None:
    ran = outcome.failed + outcome.passed
    if outcome.fault is None:
        what = "no fault: every test passes" if outcome.is_good else "NO FAULT, AND TESTS FAIL"
        print(f"{outcome.seconds:6.1f} s  {what} ({ran})", flush=True)
    else:
        what = "noticed " if outcome.is_good else "SURVIVED"
        told = f"{what} by {outcome.failed} of {ran}"
        print(f"{outcome.seconds:6.1f} s  {told:<22} {outcome.fault.name}", flush=True)
    if not outcome.is_good:
        print(outcome.log[-3000:], file=sys.stderr, flush=True)


def _conclude(outcomes: list[Outcome]) -> int:
    bad = [outcome for outcome in outcomes if not outcome.is_good]
    survivors = [outcome.fault.name for outcome in bad if outcome.fault is not None]
    faults = sum(outcome.fault is not None for outcome in outcomes)
    print(f"{faults - len(survivors)} of {faults} faults were noticed", end="")
    print(f"; not: {', '.join(survivors)}" if survivors else "")
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
