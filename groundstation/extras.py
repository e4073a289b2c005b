"""Parts that are installed on request: the extras of pyproject.toml."""

from __future__ import annotations

DISTRIBUTION = "crazyflie-groundstation"
"""What the package index and pip call this program; it is imported as ``groundstation``."""


def install(extra: str) -> str:
    """The command that adds ``extra`` to this program, however it was installed."""
    return f"pip install '{DISTRIBUTION}[{extra}]'"
