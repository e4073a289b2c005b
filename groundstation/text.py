"""Text that every format can carry."""

from __future__ import annotations


def printable(text: str) -> str:
    r"""The text with whatever UTF-8 cannot carry escaped.

    The bytes of a file name that is not UTF-8 are lone surrogates in Python: ``\udcff``.
    """
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
