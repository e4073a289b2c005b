"""Which rows of a table are read, and how far apart they are."""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.errors import BadInputError


@dataclass(frozen=True, slots=True)
class Rows:
    """only: a column and the value that it has in the rows that are read; None: all rows. rate_hz:
    rows a second of a table without a time column; 0: there is one."""

    only: tuple[str, str] | None = None
    rate_hz: float = 0.0

    def __bool__(self) -> bool:
        return self.only is not None or self.rate_hz > 0.0


EVERY_ROW = Rows()


def rows_of(only: str | None, rate_hz: float | None) -> Rows:
    """As a command line says it: ``COLUMN=VALUE``, and rows a second.

    Raises BadInputError where there is no ``=``.
    """
    if only is None:
        return Rows(None, rate_hz or 0.0)
    column, mark, value = only.partition("=")
    if not mark or not column:
        raise BadInputError(f"--only {only!r}: must be COLUMN=VALUE, as in --only id=7")
    return Rows((column, value), rate_hz or 0.0)
