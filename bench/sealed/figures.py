"""The figures of docs/evidence.md from a folder of results: power and confusion."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.sealed.cases import POWER_SIGMAS
from bench.sealed.hidden import LISTED, OUTSIDE
from bench.sealed.tables import group_of, names_of, sigmas_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Line = dict[str, Any]
NOTHING = "nothing"
COLOURS = "RdBu"
"""Right is blue, wrong is red."""


def draw(lines: list[Line], folder: Path) -> list[Path]:
    """Write ``discrepancy_power.svg`` and ``discrepancy_confusion.svg`` where there are cases."""
    written = []
    for name, drawn in (("power", _power(lines)), ("confusion", _confusion(lines))):
        if drawn is not None:
            path = folder / f"discrepancy_{name}.svg"
            drawn.savefig(path, format="svg", metadata={"Date": None})
            written.append(path)
    return written


def _power(lines: list[Line]) -> Any:
    """Share named by effect and size, a panel a noise, and the number behind each share."""
    from groundstation.report.figure import figure

    panels = [
        (title, some)
        for group, title in (
            ("power", "nominal noise"),
            ("power_noise", "torque noise x6, sensor noise x2"),
        )
        if (some := [line for line in lines if group_of(line) == group])
    ]
    if not panels:
        return None
    names = [n for n in LISTED if any(names_of(line) == [n] for _, some in panels for line in some)]
    drawn, axes = figure(
        2.6 + 3.2 * len(panels), 0.9 + 0.26 * len(names), 1, len(panels), sharey=True
    )
    for ax, (title, some) in zip(axes, panels, strict=True):
        right = np.zeros((len(names), len(POWER_SIGMAS)))
        tried = np.zeros_like(right)
        for line in some:
            at = names.index(names_of(line)[0]), POWER_SIGMAS.index(sigmas_of(line))
            right[at] += line["right"] and bool(line["found"])
            tried[at] += 1
        share = right / np.where(tried > 0, tried, np.nan)
        text = [
            [f"{r:.0f}/{n:.0f}" if n else "" for r, n in zip(*rows, strict=True)]
            for rows in zip(right, tried, strict=True)
        ]
        _table(ax, share, text, [f"{s:g}" for s in POWER_SIGMAS], names)
        ax.set_title(title)
        ax.set_xlabel("hidden size, standard errors of the bound")
    return drawn


def _confusion(lines: list[Line]) -> Any:
    """What was named, by what was hidden alone: both noises, both bases, every plant."""
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
        return None
    drawn, (ax,) = figure(10.5, 8.0)
    share = counts / np.array([[max(tried[name], 1)] for name in rows])
    text = [[f"{c:.0f}" if c else "" for c in row] for row in counts]
    wrong = [[column != (row if row in LISTED else NOTHING) for column in columns] for row in rows]
    share = np.where(wrong, -share, share)
    _table(ax, share, text, columns, [f"{name} ({tried[name]})" for name in rows])
    ax.tick_params(axis="x", rotation=90)
    ax.set_xlabel("named in the report")
    ax.set_ylabel("hidden (cases)")
    return drawn


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
