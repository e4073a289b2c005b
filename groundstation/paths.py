"""Names of files that a user gives for something new."""

from __future__ import annotations

from itertools import count
from pathlib import Path


def taken(path: Path) -> str:
    """What is said of a new file whose name is taken, with the next one that is free."""
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    free = next(name for name in names if not name.exists())
    return f"{path} exists already; nothing is ever overwritten: {free.name} is free"
