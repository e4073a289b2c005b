"""``python -m bench.fleet``: is each fault named with craft and date, and nothing else?"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from bench.fleet.judge import table
from bench.fleet.run import FleetCase, run
from bench.results import read_results

EXAMPLE = """example:
  python -m bench.fleet --sound 20 --ill 10 --results results

results.jsonl has a line for each fleet; a run that was stopped goes on there.
"""


def main() -> int:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.fleet",
        description="Sealed fleets of the stand-in: made, indexed, fitted, reported, judged.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--sound", type=int, default=20, help="fleets without faults")
    parser.add_argument("--ill", type=int, default=10, help="fleets in which crafts wear and age")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="where seeds begin")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--results", type=Path, default=Path("fleet-results"))
    options = parser.parse_args()
    seeds = range(options.first, options.first + max(options.sound, options.ill))
    cases = [
        FleetCase(ill, seed)
        for seed in seeds
        for ill, count in ((True, options.ill), (False, options.sound))
        if seed - options.first < count
    ]
    for line in run(cases, options.results, options.workers):
        said = "; ".join(one["text"] for one in line.get("findings", ())) or "nothing"
        said = line.get("error", said)
        print(f"{line['case']}: {said}", file=sys.stderr, flush=True)
    print(table(read_results(options.results)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
