"""Stretches of recordings to look at first: named by hand, or marked by the live twin."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.comparison import Comparison
from groundstation.comparison.gap import AheadErrors
from groundstation.errors import BadInputError

LEAST_S = 1.0
"""A shorter stretch is widened to this: errors of fewer rows say nothing."""
TWIN, BEGAN, ENDED = "twin", "gap", "gap ended"
"""What the live twin's events are called in a recording (``service.twin``)."""


@dataclass(frozen=True, slots=True)
class Marked:
    """Seconds ``begin_s`` to ``end_s`` since the first row of a recording, and why."""

    recording: str
    begin_s: float
    end_s: float
    why: str


def by_hand(spans_s: Iterable[tuple[float, float]], recordings: Iterable[str]) -> list[Marked]:
    """The same seconds of each recording."""
    return [Marked(name, begin, end, "by hand") for begin, end in spans_s for name in recordings]


def by_twin(
    events: Sequence[Mapping[str, Any]], recording: str, first_s: float, last_s: float
) -> list[Marked]:
    """What the live twin told of a recording, the strongest first.

    events: as recorded. first_s, last_s: device time of the recording's first and last row; a
    disagreement that lasted to the end of the recording ends there.
    """
    found: dict[tuple[Any, ...], tuple[float, Marked]] = {}
    for event in events:
        details = event.get("details", {})
        if event.get("link") != TWIN or event.get("kind") not in (BEGAN, ENDED):
            continue
        begin, end = float(details["begin_s"]), details.get("end_s")
        strength = float(details["statistic"])
        key = (details["channel"], details["regime"], begin)
        before = found.get(key)
        if before is not None:
            strength = max(strength, before[0])
        until = last_s if end is None else float(end)
        if until <= first_s:
            continue  # told of in the file before this one
        begin = max(begin, first_s)
        why = f"the live twin: {event['text']}" if before is None else before[1].why
        found[key] = strength, Marked(recording, begin - first_s, until - first_s, why)
    return [marked for _, marked in sorted(found.values(), key=lambda item: -item[0])]


def within(comparison: Comparison, marked: Marked) -> Comparison:
    """The comparison on the rows of one stretch, beside the floor of the same rows.

    Raises BadInputError where nothing of it was flown.
    """
    errors, floors = [], []
    for error, floor in zip(comparison.errors, comparison.floors, strict=True):
        inside = _rows(error, marked)
        if not inside.any():
            continue
        errors.append(
            replace(
                error,
                step=_only(error.step, inside),
                horizons=tuple(_only(one, inside) for one in error.horizons),
            )
        )
        floors.append(
            replace(
                floor,
                step=_only(floor.step, inside),
                horizons=tuple(_only(one, inside) for one in floor.horizons),
            )
        )
    if not any(np.isfinite(one.horizons[0]).any() for one in errors):
        raise BadInputError(
            f"{marked.recording}: nothing is flown from {marked.begin_s:g} to {marked.end_s:g} s;"
            " give seconds in the air"
        )
    return replace(comparison, errors=tuple(errors), floors=tuple(floors))


def _rows(error: AheadErrors, marked: Marked) -> NDArray[np.bool_]:
    run = error.run
    if run.name != marked.recording:
        return np.zeros(len(run), np.bool_)
    more = max(0.0, 0.5 * (LEAST_S - (marked.end_s - marked.begin_s)))
    time = run.time_s - run.recording_start_s
    return np.asarray((time >= marked.begin_s - more) & (time < marked.end_s + more))


def _only(values: NDArray[np.float64], inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    return np.where(inside[:, None], values, np.nan)
