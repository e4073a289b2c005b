"""``python -m bench.against CHECKOUT``: the quick figures of this program beside an older one's.

Both run in turn (A B A B ...), each in a process of its own with this environment's libraries: what
else the machine does falls on both. Each is measured by its own ``quick``. Figures are medians of
what both have by the same name; a first pair, which compiles, does not count. To get the older one:
``git worktree add ../older COMMIT``.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

from bench.table import Row, header

HERE = Path(__file__).resolve().parent.parent
FIGURES = """
import json, runpy, sys
rows = runpy.run_path(sys.argv[1])["rows"]()
print(json.dumps([[row.what, row.measured, row.unit] for row in rows], default=float))
"""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.against", description=__doc__)
    parser.add_argument("checkout", type=Path, help="another state of the program")
    parser.add_argument("--pairs", type=int, default=3)
    options = parser.parse_args()
    pairs = [
        (_figures(HERE), _figures(options.checkout.resolve())) for _ in range(options.pairs + 1)
    ][1:]
    print(header())
    for what, (_, unit) in pairs[0][0].items():
        if what in pairs[0][1]:
            here, there = (statistics.median(p[side][what][0] for p in pairs) for side in (0, 1))
            print(Row(f"{what} (there)", here, there, unit).line())
    return 0


def _figures(where: Path) -> dict[str, tuple[float, str]]:
    """What the ``quick`` of a folder measures of the program there: by name, figure and unit."""
    environment = {**os.environ, "PYTHONPATH": str(where), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", FIGURES, where / "bench" / "quick.py"],
        env=environment, cwd=where, stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    return {what: (figure, unit) for what, figure, unit in json.loads(done.stdout)}


if __name__ == "__main__":
    sys.exit(main())
