"""A report as one HTML file that needs nothing else: no network, no scripts, printable."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from groundstation.errors import BadInputError
from groundstation.paths import taken
from groundstation.report.figure import svg
from groundstation.text import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Cell = str | int | float | None

_STYLE = """
:root{color-scheme:light;--ink:#1d232b;--soft:#5b6470;--line:#dfe3e8;--paper:#fff}
*{box-sizing:border-box}
body{margin:0;background:#f4f5f7;color:var(--ink);font:15px/1.5 system-ui,"Segoe UI",sans-serif}
main{max-width:1060px;margin:0 auto;padding:28px 36px 60px;background:var(--paper)}
h1{font-size:26px;margin:0 0 2px}h2{font-size:19px;margin:34px 0 8px;padding-top:10px;
border-top:1px solid var(--line)}p{margin:8px 0;max-width:80ch}
.sub{color:var(--soft);margin:0 0 16px}
table{border-collapse:collapse;margin:12px 0;font-size:13.5px;font-variant-numeric:tabular-nums}
th,td{padding:4px 12px 4px 0;border-bottom:1px solid var(--line);vertical-align:top;text-align:left}
th{color:var(--soft);font-weight:600}td.n{text-align:right}th.n{text-align:right}
.wide{overflow-x:auto}caption,figcaption{color:var(--soft);font-size:13px;text-align:left;
padding:4px 0;caption-side:bottom;max-width:95ch}
figure{margin:14px 0}figure svg{width:100%;height:auto}
.verdict{padding:10px 14px;border-left:5px solid;background:#f7f8fa;font-size:16px;margin:14px 0}
.good{border-color:#009e73}.bad{border-color:#cc3311}.neutral{border-color:#8a8f98}
pre{white-space:pre-wrap;overflow-wrap:anywhere;background:#f7f8fa;padding:8px 12px;
font-size:12.5px;line-height:1.45}
nav a{display:inline-block;color:inherit;margin-right:14px;font-size:13px}
@media print{body{background:#fff}main{padding:0;max-width:none}figure,table{break-inside:avoid}}
"""


class Page:
    """Collects a report from top to bottom; ``write`` makes the file.

    All text is escaped. Numbers in tables are shown with four significant digits.
    """

    def __init__(self, title: str, subtitle: str = "") -> None:
        self._title = title
        self._parts: list[str] = []
        self._sections: list[str] = []
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

    def bullets(self, lines: Iterable[str]) -> None:
        """Adds a list."""
        items = "".join(f"<li>{_clean(line)}</li>" for line in lines)
        self._parts.append(f"<ul>{items}</ul>")

    def code(self, lines: Iterable[str]) -> None:
        """Adds lines to be typed as they stand."""
        self._parts.append(f"<pre>{'<br>'.join(map(_clean, lines))}</pre>")

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
        note = f"<caption>{_clean(caption)}</caption>" if caption else ""
        self._parts.append(
            f'<div class="wide"><table>{note}<thead><tr>{top}</tr></thead>'
            f"<tbody>{lines}</tbody></table></div>"
        )

    def figure(self, made: Figure, caption: str) -> None:
        """Adds a figure; the caption says what one sees in it."""
        self._parts.append(
            f"<figure>{svg(made)}<figcaption>{_clean(caption)}</figcaption></figure>"
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
        return (
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport"'
            f' content="width=device-width"><title>{_clean(self._title)}</title>'
            f"<style>{_STYLE}</style></head><body><main><h1>{_clean(self._title)}</h1>{subtitle}"
            f"<nav>{contents}</nav>{''.join(self._parts)}</main></body></html>\n"
        )

    def write(self, path: Path) -> None:
        """Writes the file.

        Raises BadInputError where it exists already or cannot be written.
        """
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(self.html())
        except FileExistsError as error:
            raise BadInputError(taken(path)) from error
        except OSError as error:
            raise BadInputError(f"{path}: cannot be written: {error.strerror}") from error


def _clean(text: str) -> str:
    return escape(printable(text))


def _cell(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, float):
        return _clean(f"{cell:.4g}")
    return _clean(str(cell))
