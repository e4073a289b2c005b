"""``python -m bench [NAME...]``: one table, what, measured, reference in the same run, ratio."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path


def main(names: list[str]) -> int:
    known = sorted(
        path.stem
        for path in Path(__file__).parent.glob("*.py")
        if "\ndef rows(" in path.read_text()  # the others are run by themselves, for hours
    )
    unknown = [name for name in names if name not in known]
    if unknown:
        print(f"bench: {', '.join(unknown)} not known; use {', '.join(known)}", file=sys.stderr)
        return 2
    print(f"{'what':<64} {'measured':>12} {'reference':>12} {'ratio':>8}  unit")
    for name in names or known:
        print(f"-- {name}", flush=True)
        for what, measured, reference, unit in importlib.import_module(f"bench.{name}").rows():
            ratio = f"{measured / reference:8.3g}" if reference else "       -"
            print(f"{what:<64} {measured:>12.4g} {reference:>12.4g} {ratio}  {unit}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
