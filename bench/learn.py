"""``python -m bench.learn``: crafts learnt whole, effects hidden by seed, the seal opened at last.

A folder a craft and seed: one that was begun is gone on with, one that ``results.jsonl`` has is
not learnt again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from bench.results import Line, rows, run_cases

CRAFTS = ("crazyflie21", "crazyflie21plus", "brushless")
COMMAND = str(Path(sys.executable).with_name("groundstation"))
TITLES = (
    *("craft, seed", "names", "sizes", "gains", "RMS before", "after", "batteries", "air, s"),
    "run, s",
)


def main() -> int:
    options = _options()
    seeds = range(options.first, options.first + options.seeds)
    cases = [f"{craft}-{seed}" for seed in seeds for craft in options.crafts]
    results = options.results
    lines = run_cases(cases, results, options.jobs, lambda case: learn(case, results), _cells)
    print("\n".join(table(lines)))
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench.learn", description=__doc__)
    parser.add_argument("--crafts", nargs="+", choices=CRAFTS, default=list(CRAFTS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="where seeds begin")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, default=Path("learn-results"))
    return parser.parse_args()


def learn(case: str, results: Path) -> Line:
    """What ``learn --json`` says in the end, or the error it ended with."""
    craft, _, seed = case.rpartition("-")
    ended = subprocess.run(
        [COMMAND, "learn", "--link", f"software:{craft}", "--hide", seed, "--yes", "--json",
         "-o", str(results / case)],
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    try:
        return {"case": case, **json.loads(ended.stdout)}
    except json.JSONDecodeError:
        return {"case": case, "error": ended.stderr.strip().rpartition("\n")[2]}


def table(lines: Sequence[Line]) -> Iterator[str]:
    """A row a craft, and what the acceptance of `learn` asks for."""
    yield from rows(TITLES, lines, _cells)
    good = [line for line in lines if "error" not in line]
    sizes = [size["inside"] for line in good for size in line["hidden"]]
    changes = [change(line) for line in good]
    yield ""
    yield f"names right: {sum(line['names_right'] for line in good)} of {len(lines)}"
    yield f"sizes inside 95 %: {sum(sizes)} of {len(sizes)}"
    yield f"steps better: {sum(one < 1.0 for one in changes)} of {len(lines)}"
    yield f"most batteries: {max((line['batteries'] for line in good), default=0)}"


def change(line: Line) -> float:
    """RMS of the steps with the gains that the craft is left with, over that with stock gains."""
    if not line["gains"].startswith("written"):
        return 1.0
    return float(line["step_rms"]["after"] / line["step_rms"]["before"])


def _cells(line: Line) -> list[str]:
    if "error" in line:
        return [line["case"], line["error"], *[""] * (len(TITLES) - 2)]
    hidden = {size["effect"] for size in line["hidden"]}
    wrong = [f"missed {name}" for name in sorted(hidden - {*line["named"]})]
    wrong += [f"false {name}" for name in sorted({*line["named"]} - hidden)]
    inside = sum(size["inside"] for size in line["hidden"])
    rms = line["step_rms"] or {"before": float("nan"), "after": float("nan")}
    return [
        line["case"].replace("-", ", "),
        ", ".join(wrong) or "right",
        f"{inside} of {len(line['hidden'])}",
        line["gains"].partition(":")[0],
        *(f"{rms[when]:.3f}" for when in ("before", "after")),
        *(str(line["batteries"]), f"{line['air_s']:.0f}", f"{line['seconds']:.0f}"),
    ]


if __name__ == "__main__":
    sys.exit(main())
