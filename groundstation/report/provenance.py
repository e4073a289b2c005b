"""Where a report comes from: when it was made, by which command, with which versions."""

from __future__ import annotations

import platform
import shlex
import sys
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from groundstation import __version__

LIBRARIES = ("numpy", "scipy", "numba", "control", "matplotlib")
"""Whose numbers and figures are in reports."""


def provenance() -> dict[str, str]:
    """What stands at the foot of a report made now, by name."""
    program, *arguments = sys.argv
    command = shlex.join([Path(program).name or "python", *arguments])
    return {
        "made": datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S %z"),
        "command": command,
        "with": ", ".join(
            [
                f"groundstation {__version__}",
                f"Python {platform.python_version()}",
                *(f"{name} {_version(name)}" for name in LIBRARIES),
            ]
        ),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # run from a folder of sources
        return "unknown"
