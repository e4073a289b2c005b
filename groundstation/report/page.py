"""A report as one HTML file that needs nothing else: its look, its figures, its page."""

from __future__ import annotations

import io
import platform
import re
import shlex
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from html import escape
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from groundstation import __version__
from groundstation.errors import BadInputError
from groundstation.paths import write_new
from groundstation.text import counted, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

# The one look of reports and of the operator's page: colours by their use, light and dark.
#
# ``static/theme.css`` has those of a document. A figure is drawn in the light ones; in a page each
# becomes a variable, which has another value in the dark.


STATIC = Path(__file__).with_name("static")
THEME = STATIC / "theme.css"

INK, PAPER = "#1b2129", "#fefefe"
"""Text and axes; what lies behind text that must cover lines."""
BAND, FAINT, MISSING, GRID = "#e4e6ea", "#c3c9d1", "#eeeeee", "#dddddd"
"""Where values belong; lines that are only context; cells without a value; grid lines."""
NOTE = "#4d5763"
"""Text of less weight."""
MEASURED, MODELLED, IMPROVED = "#333333", "#d55e00", "#0072b2"
"""What was measured, what the first model says, what the better one says."""
GOOD, BAD, NEUTRAL = "#009e73", "#cc3311", "#8a8f98"
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#333333")
"""Okabe and Ito's palette, for lines that have no meaning of their own."""
ON_DARK, ON_BRIGHT = "#ffffff", "#0b0e12"
"""Text on a cell of a heat map, which looks alike in both themes."""

_BLACK = "#000000"
"""What matplotlib draws in where nobody chose."""
IN_THE_DARK = {
    INK: "#e8ecf1",
    _BLACK: "#e8ecf1",
    PAPER: "#1a2028",
    BAND: "#333d48",
    FAINT: "#4d5865",
    MISSING: "#2a323b",
    GRID: "#343d47",
    NOTE: "#aeb8c4",
    MEASURED: "#dfe4ea",
    MODELLED: "#ff9142",
    IMPROVED: "#5eb2f2",
    GOOD: "#3ccb9f",
    BAD: "#ff7d66",
    NEUTRAL: "#8f98a3",
    "#cc79a7": "#e8a0c8",
    "#e69f00": "#f2b632",
    "#56b4e9": "#8fd0f7",
}
_COLOR = re.compile(r"(?<=: )#[0-9a-f]{6}(?=[;\"])")


def style() -> str:
    """The style sheet of a report."""
    sheets = [path.read_text() for path in (THEME, STATIC / "report.css")]
    values = "".join(f"{_variable(light)}:{dark};" for light, dark in IN_THE_DARK.items())
    dark = f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {values} }} }}\n"
    return dark.join(sheets)


def themed(svg: str) -> str:
    """A figure's colours as variables, whose fallback is the light one."""

    def variable(found: re.Match[str]) -> str:
        color = found[0]
        return f"var({_variable(color)},{color})" if color in IN_THE_DARK else color

    return _COLOR.sub(variable, svg)


def _variable(color: str) -> str:
    return f"--f{color[1:]}"


# Figures in the project's one style: readable at a look, in colours that all eyes tell apart.
#
# matplotlib is imported when the first figure is made. No display and no global state: figures
# are made from the object interface and drawn as SVG.


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


# Channels over time: lines, single readings, one channel against another.


HEIGHT = 2.7


def lines(time_s: NDArray[Any], channels: Mapping[str, NDArray[Any]], label: str) -> Figure:
    """Channels (n,) by name over time, in one panel."""
    made, (axes,) = figure(height=HEIGHT)
    for color, (name, values) in zip(SERIES, channels.items(), strict=False):
        axes.plot(*thinned(time_s, values), color=color, label=name)
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    if len(channels) > 1:
        legend_above(axes)
    return made


def points(time_s: NDArray[Any], channels: Mapping[str, NDArray[Any]], label: str) -> Figure:
    """Readings (n,) that come singly, by name."""
    made, (axes,) = figure(height=HEIGHT)
    for color, (name, values) in zip((MEASURED, MODELLED), channels.items(), strict=False):
        shown = thinned(time_s, values)
        axes.plot(*shown, ".", color=color, markersize=2.5, label=name)
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    if len(channels) > 1:
        legend_above(axes, markerscale=4)
    return made


def against(
    time_s: NDArray[Any], values: NDArray[Any], label: str, other: NDArray[Any], other_label: str
) -> Figure:
    """A channel (n,) and, dashed on a scale of its own, what drives it."""
    made, (axes,) = figure(height=HEIGHT)
    axes.plot(*thinned(time_s, values), color=MEASURED)
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    beside = axes.twinx()
    beside.plot(*thinned(time_s, other), "--", color=MODELLED, linewidth=0.9)
    beside.set_ylabel(other_label, color=MODELLED)
    beside.grid(visible=False)
    return made


# Where a report comes from: when it was made, by which command, with which versions.


LIBRARIES = ("numpy", "scipy", "numba", "control", "matplotlib")
"""Whose numbers and figures are in reports."""


def provenance() -> dict[str, str]:
    """What stands at the foot of a report made now, by name."""
    program, *arguments = sys.argv
    command = shlex.join([Path(program).name or "python", *arguments])
    return {
        "made": datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S %z"),
        "command": command,
        "with": ", ".join(
            [
                f"groundstation {__version__}",
                f"Python {platform.python_version()}",
                *(f"{name} {_version(name)}" for name in LIBRARIES),
            ]
        ),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # run from a folder of sources
        return "unknown"


# A report as one HTML file that needs nothing else: no network, no scripts, printable.
#
# Figures are enlarged by style sheets alone, so that a report can be shown where nothing may run.


Cell = str | int | float | None


_NEGATIVE_ZERO = re.compile(r"(?<![\w.)-])-(0(?:\.0+)?)(?!\d|\.\d|[eE])")
"""What rounds to zero from below."""

FIRST = 3
"""Warnings that a report begins with: who reads twelve reads none."""


class Advice(NamedTuple):
    """A warning: what there is, what follows from it, what to do or to fly; no full stops."""

    what: str
    means: str
    fly: str


class Page:
    """Collects a report from top to bottom; ``write`` makes the file.

    All text is escaped. Numbers in tables are shown with four significant digits.
    """

    def __init__(self, title: str, subtitle: str = "") -> None:
        self._title = title
        self._parts: list[str] = []
        self._sections: list[str] = []
        self._figures = 0
        self._subtitle = subtitle

    def heading(self, text: str) -> None:
        """Begins a section."""
        self._sections.append(text)
        self._parts.append(f'<h2 id="s{len(self._sections)}">{_clean(text)}</h2>')

    def text(self, text: str) -> None:
        """Adds a paragraph."""
        self._parts.append(f"<p>{_clean(text)}</p>")

    def verdict(self, text: str, kind: str = "neutral") -> None:
        """Adds the sentence one reads first; kind: good, bad or neutral."""
        if kind not in ("good", "bad", "neutral"):
            raise ValueError(f"verdict kind {kind!r}: good, bad or neutral")
        self._parts.append(f'<div class="verdict {kind}">{_clean(text)}</div>')

    def next_step(self, text: str) -> None:
        """Adds what to do now: the second thing one reads."""
        self._parts.append(f'<p class="next"><strong>Next:</strong> {_clean(text)}</p>')

    def advice(self, found: Sequence[Advice], rest: Sequence[str] = ()) -> None:
        """Adds the first three of ``found``; what is beyond, and ``rest``, behind "more"."""
        self._advised(found[:FIRST])
        if len(found) > FIRST or rest:
            count = max(len(found) - FIRST, 0) + len(rest)
            with self.more(f"{counted(count, 'more note')} on this"):
                self._advised(found[FIRST:])
                if rest:
                    self.bullets(rest)

    def _advised(self, found: Sequence[Advice]) -> None:
        items = "".join(
            f"<li><strong>{_clean(one.what)}.</strong> {_clean(one.means)}."
            f" <em>{_clean(one.fly)}.</em></li>"
            for one in found
        )
        self._parts.append(f'<ul class="advice">{items}</ul>' if items else "")

    @contextmanager
    def more(self, summary: str) -> Iterator[None]:
        """What is added in the block is folded away behind a line; printed, it is open."""
        self._parts.append(f"<details><summary>{_clean(summary)}</summary>")
        yield
        self._parts.append("</details>")

    def bullets(self, lines: Iterable[str]) -> None:
        """Adds a list."""
        items = "".join(f"<li>{_clean(line)}</li>" for line in lines)
        self._parts.append(f"<ul>{items}</ul>")

    def code(self, lines: Iterable[str]) -> None:
        """Adds lines to be typed as they stand; words of a line are kept whole (``-o``)."""
        shown = (escape(printable(line)).split(" ") for line in lines)
        words = (" ".join(f"<span>{word}</span>" for word in line) for line in shown)
        self._parts.append(f"<pre>{'<br>'.join(words)}</pre>")

    def table(self, head: Sequence[str], rows: Iterable[Sequence[Cell]], caption: str = "") -> None:
        """Adds a table; None is an empty cell, numbers stand to the right."""
        body = [list(row) for row in rows]
        for row in body:
            if len(row) != len(head):
                raise ValueError(f"a row of {len(row)} cells under {len(head)} headings")
        numeric = [
            bool(body) and all(isinstance(row[i], int | float | None) for row in body)
            for i in range(len(head))
        ]
        marks = [' class="n"' if one else "" for one in numeric]
        top = "".join(f"<th{m}>{_clean(h)}</th>" for m, h in zip(marks, head, strict=True))
        lines = "".join(
            "<tr>"
            + "".join(f"<td{m}>{_cell(cell)}</td>" for m, cell in zip(marks, row, strict=True))
            + "</tr>"
            for row in body
        )
        note = f'<p class="note">{_clean(caption)}</p>' if caption else ""
        name = escape(printable(", ".join(one for one in head if one)), quote=True)
        self._parts.append(
            f'<div class="scroll" tabindex="0" role="group" aria-label="Table: {name}">'
            f"<table><thead><tr>{top}</tr></thead>"
            f"<tbody>{lines}</tbody></table></div>{note}"
        )

    def figure(self, made: Figure, caption: str) -> None:
        """Adds a figure; the caption says what one sees in it."""
        self._figures += 1
        name = escape(printable(caption), quote=True)
        drawn = themed(svg(made)).replace("<svg", f'<svg role="img" aria-label="{name}"', 1)
        self._parts.append(
            f'<figure>{_zoom(self._figures)}<div class="picture scroll" tabindex="0" role="group"'
            f' aria-label="Figure {self._figures}">{drawn}</div>'
            f"<figcaption>{_clean(caption)}</figcaption></figure>"
        )

    def links(self, targets: Iterable[tuple[str, str]]) -> None:
        """Adds links to files beside the report: (text, relative path)."""
        items = "".join(
            f'<li><a href="{escape(printable(path), quote=True)}">{_clean(text)}</a></li>'
            for text, path in targets
        )
        self._parts.append(f"<ul>{items}</ul>")

    def html(self) -> str:
        """The whole page."""
        contents = "".join(
            f'<a href="#s{i}">{_clean(name)}</a>' for i, name in enumerate(self._sections, 1)
        )
        subtitle = f'<p class="sub">{_clean(self._subtitle)}</p>' if self._subtitle else ""
        foot = "".join(
            f"<dt>{name}</dt><dd>{_clean(is_)}</dd>" for name, is_ in provenance().items()
        )
        return (
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport"'
            f' content="width=device-width"><title>{_clean(self._title)}</title>'
            f"<style>{style()}</style></head><body><main><h1>{_clean(self._title)}</h1>{subtitle}"
            f'<nav aria-label="Sections">{contents}</nav>{"".join(self._parts)}'
            f"<footer><dl>{foot}</dl></footer></main></body></html>\n"
        )

    def write(self, path: Path) -> None:
        """Writes the file.

        Raises BadInputError where it exists already or cannot be written.
        """
        write_new(path, self.html())


def fragment(page: Page) -> str:
    """What a page holds, for a notebook's cell: without its head, style and foot."""
    return f"<div>{''.join(page._parts)}</div>"


def _zoom(number: int) -> str:
    """Buttons of a figure: as wide as the page, twice, four times."""
    buttons = "".join(
        f'<input type="radio" name="zoom{number}" id="zoom{number}{kind}" class="{kind}"'
        f'{" checked" if kind == "fit" else ""}><label for="zoom{number}{kind}">{words}</label>'
        for kind, words in (("fit", "fit"), ("double", "2×"), ("fourfold", "4×"))
    )
    return (
        f'<div class="zoom" role="radiogroup" aria-label="Size of figure {number}">{buttons}</div>'
    )


def _clean(text: str) -> str:
    """Escaped, with the signs that a terminal's text does without; zero has none."""
    return escape(_NEGATIVE_ZERO.sub(r"\1", printable(text))).replace("+-", "±").replace("^2", "²")


def _cell(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, float):
        return _clean(f"{cell:.4g}")
    return _clean(str(cell))


# What results of the Python API share: a line, HTML for notebooks, warnings, a table, pictures.
#
# A result names the module that shows it; that module knows the result's type, and is loaded when
# something of it is shown.


ROWS = 20
"""Of a table that a notebook's cell shows."""


class Shown(NamedTuple):
    """A result for people. line: in short. columns: its table, by name. warnings: in words.
    pictures: by name, each drawn when it is asked for."""

    line: str
    columns: Mapping[str, Sequence[Any]]
    warnings: Sequence[str]
    pictures: Mapping[str, Callable[[], Figure]]


class Result(ABC):
    """A result that shows itself."""

    __slots__ = ()
    SHOWN_BY: ClassVar[str]
    """A function that makes a ``Shown`` of it: ``package.module:function``."""

    @abstractmethod
    def _what(self) -> str:
        """What it is called in its own line."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._what()})"

    def _repr_html_(self) -> str:
        """For notebooks: its line, the first rows of its table, and its warnings, folded away."""
        shown = self._shown()
        page = Page("")
        page.text(shown.line)
        names = list(shown.columns)
        rows = list(zip(*shown.columns.values(), strict=True))
        if rows:
            few = f"The first {ROWS} of {len(rows)}." if len(rows) > ROWS else ""
            page.table(names, rows[:ROWS], few)
        page.advice([], list(shown.warnings))
        return fragment(page)

    def to_frame(self) -> Any:
        """Its table: a pandas DataFrame where pandas is installed, otherwise a pyarrow table."""
        import pyarrow

        table = pyarrow.table({name: list(one) for name, one in self._shown().columns.items()})
        return table.to_pandas() if find_spec("pandas") else table

    @property
    def pictures(self) -> list[str]:
        """The names that ``plot`` knows."""
        return list(self._shown().pictures)

    def plot(self, picture: str = "") -> Figure:
        """One of ``pictures``, as its report has it; without a name the first.

        Raises BadInputError for another name, and where there is none.
        """
        known = self._shown().pictures
        name = picture or next(iter(known), "")
        if name not in known:
            raise BadInputError(f"no picture {name!r}; there are {', '.join(known) or 'none'}")
        return known[name]()

    def _shown(self) -> Shown:
        module, _, function = self.SHOWN_BY.partition(":")
        made: Shown = getattr(import_module(module), function)(self)
        return made
