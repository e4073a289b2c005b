"""The one look of reports and of the operator's page: colours by their use, light and dark.

``static/theme.css`` has those of a document. A figure is drawn in the light ones; in a page each
becomes a variable, which has another value in the dark.
"""

from __future__ import annotations

import re
from pathlib import Path

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
