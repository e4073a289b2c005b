"""What a flight changed in a craft, on disk until it has been settled: a program that is killed
must not leave its gains unnoticed."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

from groundstation.errors import BadInputError


def notes_path() -> Path:
    """One file for each user."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(base) / "groundstation" / "pid_fly.json"


def note_changes(uri: str, saved: dict[str, float], written: dict[str, float]) -> None:
    """Say, before anything is written, what is about to change."""
    path = notes_path()
    content = {"uri": uri, "time": time.time(), "saved": saved, "written": written}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".new")
        partial.write_text(json.dumps(content))
        partial.replace(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror}") from error


def forget_changes() -> None:
    """All is as it is meant to be."""
    notes_path().unlink(missing_ok=True)


def changes_left() -> dict[str, Any] | None:
    """What an earlier flight changed and never settled, or None."""
    try:
        content = json.loads(notes_path().read_text())
        return {
            "uri": str(content["uri"]),
            "time": float(content["time"]),
            "saved": {str(k): float(v) for k, v in content["saved"].items()},
            "written": {str(k): float(v) for k, v in content["written"].items()},
        }
    except FileNotFoundError:
        return None
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return {"uri": "?", "time": 0.0, "saved": {}, "written": {}}
