"""Which seconds of a recording to identify on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.identification.runs import Run

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Selection:
    """What to identify on.

    spans_s: (from, to) in seconds of device time since the recording's first row, any of which a
    row must lie in; none: the whole recording.
    """

    spans_s: tuple[tuple[float, float], ...] = ()

    def __str__(self) -> str:
        spans = ", ".join(f"{a:g} to {b:g} s" for a, b in self.spans_s)
        return f"in {spans}" if spans else "anything"


EVERYTHING = Selection()


def parse_selection(segments: tuple[str, ...] = ()) -> Selection:
    """A selection as typed: ``12.5:40`` (seconds). Raises BadInputError."""
    return Selection(tuple(span_of(text, "--segment") for text in segments))


def span_of(text: str, option: str) -> tuple[float, float]:
    """Seconds as typed after an option: ``12.5:40``. Raises BadInputError."""
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low, high = math.nan, math.nan
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise BadInputError(f"{option} {text}: give two rising numbers, for instance 12.5:40")
    return low, high


def selected(run: Run, selection: Selection) -> Mask:
    """Rows (n,) of a run that a selection chooses."""
    if not selection.spans_s:
        return np.ones(len(run), np.bool_)
    time = run.time_s - run.recording_start_s
    return np.any([(time >= a) & (time < b) for a, b in selection.spans_s], axis=0)
