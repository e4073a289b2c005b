"""The figure of docs/evidence.md from a folder of results: what was named, by what was hidden."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.sealed.hidden import LISTED, OUTSIDE
from bench.sealed.tables import group_of, names_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Line = dict[str, Any]
NOTHING = "nothing"
COLOURS = "RdBu"
"""Right is blue, wrong is red."""


def draw(lines: list[Line], path: Path) -> None:
    """An SVG of singles: both noises, both bases. Raises ValueError where there are none."""
    from groundstation.report.figure import figure

    rows = (*LISTED, *OUTSIDE, NOTHING)
    columns = (*LISTED, NOTHING)
    counts = np.zeros((len(rows), len(columns)))
    tried: Counter[str] = Counter()
    for line in lines:
        single = group_of(line) in ("single", "noise", "outside", "quiet", "quiet_noise")
        if not single or not line["counted"] or "found" not in line:
            continue
        (hidden,) = names_of(line) or [NOTHING]
        tried[hidden] += 1
        false = line["false"]
        true = [name for name in line["found"] if name == hidden]
        for name in [*false, *true] or [NOTHING]:
            counts[rows.index(hidden), columns.index(name)] += 1
    if not tried:
        raise ValueError("no case with one effect or none was judged; run some first")
    drawn, (ax,) = figure(10.5, 8.0)
    share = counts / np.array([[max(tried[name], 1)] for name in rows])
    text = [[f"{c:.0f}" if c else "" for c in row] for row in counts]
    wrong = [[column != (row if row in LISTED else NOTHING) for column in columns] for row in rows]
    share = np.where(wrong, -share, share)
    _table(ax, share, text, columns, [f"{name} ({tried[name]})" for name in rows])
    ax.tick_params(axis="x", rotation=90)
    ax.set_xlabel("named in the report")
    ax.set_ylabel("hidden (cases)")
    drawn.savefig(path, format="svg", metadata={"Date": None})


def _table(
    ax: Axes,
    share: NDArray[np.float64],
    text: list[list[str]],
    columns: Any,
    rows: Any,
) -> None:
    ax.imshow(share, cmap=COLOURS, vmin=-1.0, vmax=1.0, aspect="auto")
    ax.set_xticks(range(len(columns)), columns)
    ax.set_yticks(range(len(rows)), rows)
    ax.grid(visible=False)
    ax.set_xticks(np.arange(0.5, len(columns)), minor=True)
    ax.set_yticks(np.arange(0.5, len(rows)), minor=True)
    ax.grid(visible=True, which="minor")
    ax.tick_params(which="minor", length=0)
    ax.tick_params(labelsize=8)
    for row, cells in enumerate(text):
        for column, cell in enumerate(cells):
            dark = abs(share[row, column]) > 0.6
            ax.text(
                column,
                row,
                cell,
                ha="center",
                va="center",
                fontsize=7.5,
                color="white" if dark else "#333333",
            )
