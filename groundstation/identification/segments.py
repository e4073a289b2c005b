"""Which rows of a flight to identify on: by hand, by criterion, or automatically (thesis 7.3.5).

The thesis groups its flights by whether the craft hovers or moves, whether the altitude is
constant, and drops what unregulated air disturbs. Here each criterion is a mask over rows, decided
over a window around each row, and a selection is what all of its criteria share.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.identification.runs import Run
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WINDOW_S = 1.0
"""Over which a row's surroundings are judged."""
STILL_RAD_S, LEVEL_RAD = math.radians(25.0), math.radians(4.0)
"""RMS of the rates (after a 10 Hz mean) and of the tilt below which a craft hovers."""
STEADY_M_S2 = 0.35
"""Mean vertical acceleration, by the accelerometer, below which the altitude is steady."""
FULL, LOW = 0.995, 0.02
"""Duties at which a motor cannot follow any further."""


@dataclass(frozen=True, slots=True)
class Selection:
    """What to identify on.

    criteria: names in ``CRITERIA``, all of which must hold. battery_v: (low, high) of the
    reported voltage. spans_s: (from, to) in seconds of device time since the recording's first
    row, any of which a row must lie in; none: the whole recording.
    """

    criteria: tuple[str, ...] = ()
    battery_v: tuple[float, float] | None = None
    spans_s: tuple[tuple[float, float], ...] = ()

    def __str__(self) -> str:
        parts = [name.replace("_", " ") for name in self.criteria]
        if self.battery_v is not None:
            parts.append("at {:g} to {:g} V".format(*self.battery_v))
        if self.spans_s:
            parts.append("in " + ", ".join(f"{a:g} to {b:g} s" for a, b in self.spans_s))
        return " and ".join(parts) or "anything"


EVERYTHING = Selection()


def parse_selection(select: str, segments: tuple[str, ...] = ()) -> Selection:
    """A selection as typed: ``moving,unsaturated,battery=3.5:4.1`` and ``12.5:40`` (seconds).

    Raises BadInputError, naming the criteria there are.
    """
    names: list[str] = []
    battery = None
    for word in (part.strip() for part in select.split(",")):
        if word.startswith("battery="):
            battery = _range(word.removeprefix("battery="), f"--select {word}", "3.5:4.1")
        elif word in CRITERIA:
            names.append(word)
        elif word:
            raise BadInputError(
                f"--select {word}: there are {', '.join(CRITERIA)} and battery=LOW:HIGH"
            )
    spans = tuple(span_of(text, "--segment") for text in segments)
    return Selection(tuple(names), battery, spans)


def span_of(text: str, option: str) -> tuple[float, float]:
    """Seconds as typed after an option: ``12.5:40``. Raises BadInputError."""
    return _range(text, f"{option} {text}", "12.5:40")


def selected(run: Run, selection: Selection) -> Mask:
    """Rows (n,) of a run that a selection chooses.

    Raises BadInputError where a criterion needs a channel that the run lacks.
    """
    mask = np.ones(len(run), np.bool_)
    for name in selection.criteria:
        mask &= CRITERIA[name](run)
    if selection.battery_v is not None:
        if not np.isfinite(run.supply_v).all():
            raise BadInputError(f"{run.name}: no battery voltage to choose by")
        mask &= (run.supply_v >= selection.battery_v[0]) & (run.supply_v <= selection.battery_v[1])
    if selection.spans_s:
        time = run.time_s - run.recording_start_s
        mask &= np.any([(time >= a) & (time < b) for a, b in selection.spans_s], axis=0)
    return mask


def hover(run: Run) -> Mask:
    """Rates and tilt stay small: the craft hangs in the air, its axes hardly move."""
    rate = _around(_smooth(run.gyro, run) ** 2, run).sum(axis=1)
    still = np.sqrt(rate) < STILL_RAD_S
    if not np.isfinite(run.attitude).all():
        return np.asarray(still)
    level = np.sqrt(_around(run.attitude[:, :2] ** 2, run).sum(axis=1)) < LEVEL_RAD
    return np.asarray(still & level)


def moving(run: Run) -> Mask:
    """The opposite of hover: axes are excited."""
    return ~hover(run)


def steady_altitude(run: Run) -> Mask:
    """Vertical specific force averages gravity: neither climb nor descent begins or ends.

    Specific force is turned upright by the reported attitude (level, where there is none).
    """
    if not np.isfinite(run.accelerometer).all():
        raise BadInputError(f"{run.name}: no accelerometer to judge the altitude by")
    roll, pitch = (
        run.attitude[:, :2].T if np.isfinite(run.attitude).all() else np.zeros((2, len(run)))
    )
    x, y, z = run.accelerometer.T
    up = -np.sin(pitch) * x + np.cos(pitch) * (np.sin(roll) * y + np.cos(roll) * z)
    return np.asarray(np.abs(_around(up[:, None], run)[:, 0] - STANDARD_GRAVITY) < STEADY_M_S2)


def unsaturated(run: Run) -> Mask:
    """No motor is at full or at zero duty within a tenth of a second: torque follows control."""
    limited = np.asarray(((run.duty >= FULL) | (run.duty <= LOW)).any(axis=1))
    return np.asarray(~_near(limited, round(0.1 / run.period_s)))


def saturated(run: Run) -> Mask:
    """The opposite of unsaturated."""
    return ~unsaturated(run)


def auto(run: Run) -> Mask:
    """What suits a fit: unsaturated flight without knocks and, by the accelerometer, at a steady
    altitude; where that leaves less than a third of the run, altitude is not asked for."""
    good = unsaturated(run)
    if not np.isfinite(run.accelerometer).all():
        return good
    force = np.linalg.norm(run.accelerometer, axis=1)
    slow = np.abs(_smooth(force[:, None], run)[:, 0] - STANDARD_GRAVITY)
    good &= ~_near(slow > 0.8 * STANDARD_GRAVITY, round(0.2 / run.period_s))
    steady = good & steady_altitude(run)
    return np.asarray(steady if steady.mean() > 1 / 3 else good)


CRITERIA: dict[str, Callable[[Run], Mask]] = {
    "hover": hover,
    "moving": moving,
    "steady_altitude": steady_altitude,
    "unsaturated": unsaturated,
    "saturated": saturated,
    "auto": auto,
}


def _smooth(values: Array, run: Run) -> Array:
    """Mean over a tenth of a second around each row: without vibration and sensor noise."""
    return _mean(values, max(1, round(0.1 / run.period_s)))


def _around(values: Array, run: Run) -> Array:
    """Mean over ``WINDOW_S`` around each row."""
    return _mean(values, max(1, round(WINDOW_S / run.period_s)))


def _mean(values: Array, width: int) -> Array:
    """Centred moving mean of (n, m), over what there is at the ends."""
    sums = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    rows = np.arange(len(values))
    first, last = np.maximum(rows - width // 2, 0), np.minimum(rows + width // 2 + 1, len(values))
    return np.asarray((sums[last] - sums[first]) / (last - first)[:, None])


def _near(mask: Mask, rows: int) -> Mask:
    """Rows within so many rows of a true one."""
    return np.asarray(_mean(mask[:, None].astype(np.float64), 2 * rows + 1)[:, 0] > 1e-9)


def _range(text: str, where: str, example: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low, high = math.nan, math.nan
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise BadInputError(f"{where}: give two rising numbers, for instance {example}")
    return low, high
