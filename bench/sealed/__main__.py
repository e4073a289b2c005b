"""``python -m bench.sealed run|make|table``: the acceptance matrix of ``discrepancy``."""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import asdict
from pathlib import Path

from bench.sealed.cases import GROUPS, PLAIN, Mode, matrix, named
from bench.sealed.hidden import LISTED
from groundstation.dynamics.vehicle import BUILT_IN

EXAMPLES = """examples:
  python -m bench.sealed run --only single quiet --seeds 2 --results results
  python -m bench.sealed run --case single:rotor_drag:3:clean --results results --keep
  python -m bench.sealed run --only single quiet --craft crazyflie21 --seeds 2 --results results
  python -m bench.sealed make single:rotor_drag:3:clean -o folder       (see what the search sees)
  python -m bench.sealed table --results results

The results folder holds one line a case (results.jsonl); a run that was stopped goes on there.
Tables judge what was hidden and said anew, so a mended judge needs no new searches.
"""


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bench.sealed",
        description="Hide effects by seed, search in another process, judge.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="run cases, then print the tables")
    run.add_argument(
        "--only",
        nargs="+",
        choices=GROUPS,
        default=list(GROUPS),
        metavar="GROUP",
        help=f"of {', '.join(GROUPS)}",
    )
    run.add_argument("--names", nargs="+", choices=LISTED, metavar="EFFECT", default=[])
    run.add_argument(
        "--mode",
        choices=("clean", "affected", "both"),
        default="both",
        help="where the base model comes from",
    )
    run.add_argument("--seeds", type=int, default=10)
    run.add_argument("--first", type=int, default=0, metavar="SEED", help="where seeds begin")
    run.add_argument(
        "--craft",
        choices=tuple(BUILT_IN),
        default=PLAIN,
        help="one of today's is heard by its radio's log blocks, 250 rows a second, and has no"
        " motor bench",
    )
    run.add_argument("--case", nargs="+", default=[], help="these cases only")
    run.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    run.add_argument("--keep", action="store_true", help="keep the folders of wrong cases")
    make = commands.add_parser("make", help="write one case's recordings and model")
    make.add_argument("case")
    make.add_argument("-o", "--output", type=Path, required=True, help="a new folder")
    make.add_argument("--open", action="store_true", help="print what is hidden")
    table = commands.add_parser("table", help="what was judged, in tables")
    for one in (run, make, table):
        one.add_argument("--results", type=Path, default=Path("sealed-results"))
    options = parser.parse_args()
    try:
        return COMMANDS[options.command](options)
    except ValueError as error:
        print(f"bench.sealed: {error}", file=sys.stderr)
        return 1


def _run(options: argparse.Namespace) -> int:
    from bench.sealed.run import run

    modes: tuple[Mode, ...] = ("clean", "affected")
    if options.mode != "both":
        modes = (options.mode,)
    cases = [named(text) for text in options.case] or [
        case
        for case in matrix(tuple(options.only), modes, options.seeds, options.first, options.craft)
        if not options.names or set(case.names) & set(options.names)
    ]
    for line in run(cases, options.results, options.workers, keep=options.keep):
        word = "right" if line["right"] else "WRONG"
        word = word if line["counted"] else f"({word})"
        said = line.get("error") or f"{line['verdict']}: {', '.join(line['found']) or '-'}"
        print(f"{word:<8} {line['case']:<60} {said}", file=sys.stderr, flush=True)
    return _table(options)


def _make(options: argparse.Namespace) -> int:
    from bench.sealed.flights import Generator
    from bench.sealed.run import search_arguments

    sealed = Generator(options.results / "families").make(named(options.case), options.output)
    print("groundstation", *search_arguments(options.output))
    if options.open:
        print(json.dumps(asdict(sealed), indent=2))
    return 0


def _table(options: argparse.Namespace) -> int:
    from bench.sealed.run import judged_again
    from bench.sealed.tables import tables

    print(tables(judged_again(options.results)))
    return 0


COMMANDS = {"run": _run, "make": _make, "table": _table}

if __name__ == "__main__":
    sys.exit(main())
