"""A table or figure of the thesis, and what is made of it here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from groundstation.report.page import Cell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from groundstation.thesis.workshop import Workshop


@dataclass(frozen=True, slots=True)
class Table:
    """head: of the columns; "printed" in one says that its numbers are the thesis's."""

    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Head and rows."""
        return {"head": list(self.head), "rows": [list(row) for row in self.rows]}


@dataclass(frozen=True, slots=True)
class Made:
    """What stands on the page. says: what one sees, and what it means."""

    says: str
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


@dataclass(frozen=True, slots=True)
class Entry:
    """number: as printed, "Table 7.1". make: draws it from what the workshop has."""

    number: str
    title: str
    make: Callable[[Workshop], Made]


@dataclass(frozen=True, slots=True)
class Done:
    """An entry with the commands that made it, and ``chain``: these and all that they need, in the
    order in which they make it from nothing."""

    entry: Entry
    made: Made
    commands: Sequence[str]
    chain: Sequence[str]
