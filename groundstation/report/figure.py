"""Figures in the project's one style: readable at a look, in colours that all eyes tell apart.

matplotlib is imported when the first figure is made. No display and no global state: figures
are made from the object interface and drawn as SVG.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from groundstation.report.theme import (
    GRID,
    INK,
    PAPER,
)
from groundstation.text import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

HEAT = "cividis"
"""Colour map for sizes; ``coolwarm`` where a sign matters."""

_STYLE = {
    "font.size": 10.0,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 11.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GRID,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.facecolor": "none",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "svg.fonttype": "path",
    "svg.hashsalt": "groundstation",
    "path.simplify": True,
    "path.simplify_threshold": 0.4,
}
MOST_POINTS = 2500


def figure(
    width: float = 9.0, height: float = 3.2, rows: int = 1, columns: int = 1, **layout: Any
) -> tuple[Figure, list[Axes]]:
    """A figure and its axes, row by row. width, height: inches; the height is the whole figure's.

    layout: what ``Figure.subplots`` takes (sharex, width_ratios ...).
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        made = Figure(figsize=(width, height), layout="constrained")
        axes = made.subplots(rows, columns, squeeze=False, **layout)
    return made, [one for row in axes for one in row]


def legend_above(axes: Axes, **more: Any) -> None:
    """A legend over the panel, to the right: what lies in it may be a peak."""
    names = axes.get_legend_handles_labels()[1]
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, ncols=len(names), **more
    )


def svg(made: Figure) -> str:
    """The figure as an ``<svg>`` element that scales with the page; same input, same text."""
    import matplotlib

    _finish(made)
    out = io.StringIO()
    with matplotlib.rc_context(_STYLE):
        made.savefig(out, format="svg", facecolor="none", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    return text[text.index("<svg") :].strip()


def png(made: Figure, dots_per_inch: int = 110) -> bytes:
    """The figure as a picture, for pages that cannot show SVG."""
    import matplotlib

    _finish(made)
    out = io.BytesIO()
    with matplotlib.rc_context(_STYLE):
        made.savefig(out, format="png", dpi=dots_per_inch, metadata={"Software": None})
    return out.getvalue()


def _finish(made: Figure) -> None:
    """Legends let what lies behind them shine through. Names of files are no formulas and hold
    no controls; only ticks have formulas, when drawn."""
    from matplotlib.legend import Legend
    from matplotlib.text import Text

    for legend in made.findobj(Legend):
        assert isinstance(legend, Legend)
        legend.get_frame().set(facecolor=PAPER, edgecolor="none", alpha=0.75)
    for text in made.findobj(Text):
        assert isinstance(text, Text)
        text.set_text("\n".join(map(printable, text.get_text().split("\n"))))
        if "$" in text.get_text():
            text.set_parse_math(False)


def thinned(*columns: Sequence[float] | NDArray[Any], most: int = MOST_POINTS) -> tuple[Any, ...]:
    """Columns of one length with every k-th row, so that a drawing stays small.

    For lines that are smooth at the drawn scale; an envelope is the caller's business.
    """
    import numpy as np

    step = max(1, -(-len(columns[0]) // most))
    return tuple(np.asarray(column)[::step] for column in columns)
