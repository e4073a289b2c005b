"""``python -m bench [--json] [PART...]``: one table, each figure beside its reference or limit."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from pathlib import Path
from typing import Any

from bench.table import header


def main() -> int:
    known = _parts()
    parser = argparse.ArgumentParser(
        prog="python -m bench",
        description="What was measured, a reference measured in the same run and their ratio, and"
        " the limit where one is set; one that is missed ends it with status 1. quick: two"
        " minutes, all in this process. Apart, for hours: bench.soak, bench.sealed.",
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(known)}")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    chosen = parser.parse_args()
    if unknown := [name for name in chosen.parts if name not in known]:
        parser.error(f"{', '.join(unknown)} not known; there are {', '.join(known)}")
    rows: list[dict[str, Any]] = []
    if not chosen.json:
        print(header())
    for part in chosen.parts or known:
        print(f"bench: {part}", file=sys.stderr, flush=True)
        for row in importlib.import_module(f"bench.{part}").rows():
            rows.append(row.as_dict(part))
            if not chosen.json:
                print(row.line(), flush=True)
    if chosen.json:
        print(json.dumps(rows, indent=2, default=float))
    missed = [row["what"] for row in rows if row["met"] is False]
    for what in missed:
        print(f"bench: limit missed: {what}", file=sys.stderr)
    return int(bool(missed))


def _parts() -> list[str]:
    """The modules beside this one that give rows; the others run by themselves, for hours."""
    return sorted(
        path.stem
        for path in Path(__file__).parent.glob("*.py")
        if "\ndef rows(" in path.read_text()
    )


if __name__ == "__main__":
    sys.exit(main())
