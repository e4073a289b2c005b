"""What flights changed in crafts, on disk until it has been settled: a program that is killed
must not leave its gains unnoticed."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

from groundstation import BadInputError


def notes_path() -> Path:
    """One file for each user."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(base) / "groundstation" / "pid_fly.json"


Written = dict[str, list[float]]
"""Values that flights wrote, or were about to write when they ended."""


def also_written(written: Written, changed: dict[str, float]) -> Written:
    """What flights wrote, and what one is about to write."""
    return written | {name: [*written.get(name, []), value] for name, value in changed.items()}


def note_changes(uri: str, saved: dict[str, float], written: Written) -> None:
    """Say, before anything is written, what is about to change on the craft at ``uri``."""
    note = {"time": time.time(), "saved": saved, "written": written}
    _put({**_notes(), uri: note})


def forget_changes(uri: str) -> None:
    """All is as it is meant to be on the craft at ``uri``."""
    notes = _notes()
    if notes.pop(uri, None) is not None:
        _put(notes)


def changes_left(uri: str) -> dict[str, Any] | None:
    """What earlier flights changed on the craft at ``uri`` and never settled: ``time``, ``saved``,
    ``written``; or None."""
    return _notes().get(uri)


def still_changed(left: dict[str, Any], present: dict[str, float]) -> dict[str, float]:
    """Of what a flight left changed, what the craft still holds as that wrote it, and the former
    values. Others were set anew since, by somebody or by the craft's restart, which forgets them:
    what was found before the flight has no business on it any more."""
    import numpy as np

    still = {}
    for name, former in left["saved"].items():
        now = np.float32(present.get(name, np.nan))
        wrote = any(now == np.float32(one) for one in left["written"].get(name, ()))
        if wrote and now != np.float32(former):
            still[name] = former
    return still


def crafts_left() -> list[str]:
    """The crafts on which something was left changed."""
    return list(_notes())


def _notes() -> dict[str, dict[str, Any]]:
    path = notes_path()
    try:
        content = json.loads(path.read_text())
        return {
            str(uri): {
                "time": float(note["time"]),
                "saved": {str(k): float(v) for k, v in note["saved"].items()},
                "written": {
                    str(k): [float(one) for one in (v if isinstance(v, list) else [v])]
                    for k, v in note["written"].items()
                },
            }
            for uri, note in content.items()
        }
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise BadInputError(
            f"{path}: cannot be read ({error}), so it is not known what an interrupted flight left"
            " changed; look at the craft's gains, then remove the file"
        ) from error


def _put(notes: dict[str, dict[str, Any]]) -> None:
    path = notes_path()
    try:
        if not notes:
            path.unlink(missing_ok=True)
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".new")
        partial.write_text(json.dumps(notes))
        partial.replace(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror}") from error
