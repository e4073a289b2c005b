"""What results of the Python API share: a line, HTML for notebooks, warnings, a table, pictures.

A result names the module that shows it; that module knows the result's type, and is loaded when
something of it is shown.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from groundstation.errors import BadInputError
from groundstation.report.page import Page, fragment

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
