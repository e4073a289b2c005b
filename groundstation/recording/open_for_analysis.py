"""A recording as every analysis takes it: what is not believed of it is missing."""

from __future__ import annotations

from pathlib import Path

from groundstation.recording.open_recording import open_recording
from groundstation.recording.session import Recording
from groundstation.recording.soundness import sound


def open_for_analysis(path: str | Path) -> Recording:
    """Read a recording as ``open_recording`` does, and take as missing (NaN) what
    ``soundness.rejections`` does not believe; ``soundness.rejected`` says what that is.

    Raises BadInputError or RecordingError, one line each, for what cannot be read.
    """
    return sound(open_recording(path))
