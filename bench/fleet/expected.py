"""``python -m bench.fleet.expected CATALOGUE...``: errors that catalogues expected of fits, beside
those that the fits then reported."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.fleet.certainty import PERCENT
from groundstation.fleet.fit import fits_table
from groundstation.fleet.flight_fit import CONSTANTS
from groundstation.fleet.index import recordings_of


def pairs(catalogue: Path, name: str) -> tuple[list[float], list[float], int]:
    """(expected, reported) relative errors of a constant, %, and in how many fits it was not
    identified although one was expected."""
    fits = fits_table(catalogue).rows()
    expected, reported, untold = [], [], 0
    for row in recordings_of(catalogue):
        fit, percent = fits.get(row["address"]), row[PERCENT[name]]
        if fit is None or fit["reason"] is not None or percent is None:
            continue
        if fit[name] is None:
            untold += 1
            continue
        expected.append(percent)
        reported.append(100.0 * fit[f"{name}_stderr"] / abs(fit[name]))
    return expected, reported, untold


def _row(name: str, expected: list[float], reported: list[float], untold: int) -> str:
    from scipy.stats import spearmanr

    if len(expected) < 3:
        return f"| {name} | {len(expected)} | {untold} | | | |"
    ratio: NDArray[np.float64] = np.array(reported) / np.array(expected)
    low, middle, high = np.quantile(ratio, (0.1, 0.5, 0.9))
    order = float(spearmanr(expected, reported).statistic)
    within = f"{low:.2f} to {high:.2f}"
    return f"| {name} | {len(ratio)} | {untold} | {middle:.2f} | {within} | {order:.2f} |"


def main() -> int:
    print("| constant | fits | not identified | reported over expected | 80 % within | in order |")
    print("|---|---|---|---|---|---|")
    for name in CONSTANTS:
        found = [pairs(Path(one), name) for one in sys.argv[1:]]
        expected, reported = ([x for one in found for x in one[k]] for k in (0, 1))
        print(_row(name, expected, reported, sum(one[2] for one in found)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
