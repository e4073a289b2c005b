"""Text that every format can carry, and every terminal show."""

from __future__ import annotations

import re
from collections.abc import Sequence

_CONTROLS = re.compile(
    r"[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""C0 and C1 (escape sequences, new lines), what turns the direction of writing, and surrogates."""

NAMED_MOST = 12
"""Columns, values or series that a sentence names of many."""


def printable(text: str) -> str:
    r"""One line for people: what would command a terminal, or UTF-8 cannot carry, is escaped."""
    return _CONTROLS.sub(lambda found: ascii(found[0])[1:-1], text)


def encodable(text: str) -> str:
    r"""The text with whatever UTF-8 cannot carry escaped.

    The bytes of a file name that is not UTF-8 are lone surrogates in Python: ``\udcff``.
    """
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def listed(names: Sequence[str]) -> str:
    """``a, b and c``; of at least one name."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def some(names: Sequence[str], most: int = NAMED_MOST) -> str:
    """``a, b and 3 more``."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def counted(number: int, noun: str) -> str:
    """``1 flight``, ``2 flights``."""
    return f"{number} {noun}{'s' * (number != 1)}"
