"""A report as one HTML file that needs nothing else: no network, no scripts, printable.

Figures are enlarged by style sheets alone, so that a report can be shown where nothing may run.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from groundstation.errors import BadInputError
from groundstation.paths import taken
from groundstation.report.figure import svg
from groundstation.report.provenance import provenance
from groundstation.report.theme import style, themed
from groundstation.text import counted, printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(self.html())
        except FileExistsError as error:
            raise BadInputError(taken(path)) from error
        except OSError as error:
            raise BadInputError(f"{path}: cannot be written: {error.strerror}") from error


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
