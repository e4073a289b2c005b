"""What the pilot flies: programmes in TOML, a few of them built in.

A programme is a list of segments, flown one after the other; ``repeat`` starts again from a
segment for ever. Each segment lasts ``seconds`` and says what the sticks do::

    name = "doublets"
    repeat = 1                      # index of the segment to go back to, absent: stop at the end

    [[segment]]
    kind = "rest"                   # motors off
    seconds = 3
    [[segment]]
    kind = "fly"
    seconds = 30
    height_m = 0.8
    [[segment.excite]]
    axis = "roll"                   # roll, pitch (deg), yaw (deg/s), height (m),
                                    # collective (share of the hover thrust)
    shape = "doublet"               # step, doublet, sine, multisine, chirp, random
    amplitude = 8
    period_s = 2.0
    start_s = 1.0

Kinds: ``rest``; ``fly`` (the pilot holds height and place); ``bench`` (craft fixed, ``thrust``
16-bit with ``excite`` on axis ``thrust``); ``hand`` (held: roll, pitch and yaw of the craft in
degrees, pitch nose down positive as everywhere outside the firmware).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_sim.layout import (
    FIXED,
    FREE,
    HELD,
    PASS_NS,
    PILOT_PASSES,
    ROW_COLUMNS,
    ROW_KEEP,
    ROW_LEVEL,
    ROW_MODE,
    ROW_PITCH,
    ROW_PUSH,
    ROW_ROLL,
    ROW_THRUST,
    ROW_YAW,
    THRUST_DIRECT,
    THRUST_HEIGHT,
    THRUST_OFF,
)
from groundstation.documents import decode_toml, read_document

TICK_S = PILOT_PASSES * PASS_NS * 1e-9
Kind = Literal["rest", "fly", "bench", "hand"]
Axis = Literal["roll", "pitch", "yaw", "height", "collective", "thrust"]
Shape = Literal["step", "doublet", "sine", "multisine", "chirp", "random", "trapeze"]


class Excitation(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One signal on one axis of a segment.

    shape: ``step`` (on from start to end), ``doublet`` (plus, minus, pause, in thirds of the
        period, repeated), ``sine``, ``multisine`` (eight lines from low_hz to high_hz, random
        phases), ``chirp`` (low_hz to high_hz over the window), ``random`` (a new level each
        period), ``trapeze`` (smoothly to the amplitude, to its negative, and back to zero).
    """

    axis: Axis
    shape: Shape
    amplitude: float
    period_s: float = 1.0
    start_s: float = 0.0
    end_s: float | None = None
    low_hz: float = 0.2
    high_hz: float = 5.0


class Segment(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A stretch of a programme."""

    kind: Kind
    seconds: float
    height_m: float = 0.8
    thrust: float = 0.0
    keep: float = 1.0
    excite: tuple[Excitation, ...] = ()


class Programme(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Segments in order; ``repeat`` is the index to go on from after the last."""

    name: str
    segment: tuple[Segment, ...]
    repeat: int | None = None


def load_programme(source: str) -> Programme:
    """A built-in programme by name or a TOML file. Raises ValueError saying what is wrong."""
    if source in BUILT_IN:
        return BUILT_IN[source]
    path = Path(source)
    if not path.is_file():
        raise ValueError(
            f"pilot programme {source!r}: neither built in ({', '.join(BUILT_IN)}) nor a file"
        )
    try:
        programme = decode_toml(read_document(path), Programme)
    except (OSError, ValueError) as error:
        raise ValueError(f"pilot programme {path}: {error}; correct the file") from error
    if not programme.segment or any(not s.seconds >= TICK_S for s in programme.segment):
        raise ValueError(f"pilot programme {path}: needs segments of at least {TICK_S} s")
    if programme.repeat is not None and not 0 <= programme.repeat < len(programme.segment):
        raise ValueError(f"pilot programme {path}: repeat {programme.repeat} is no segment")
    return programme


class _Held(NamedTuple):
    """A segment's running number, the tick of its first row, and its rows (n, 7)."""

    number: int
    start: int
    table: NDArray[np.float64]

    @property
    def end(self) -> int:
        return self.start + len(self.table)


class Sticks:
    """The rows of a programme, computed segment by segment as the flight goes on; two are held,
    for the craft asks for rows a little ahead of those it has flown."""

    def __init__(self, programme: Programme, seed: int) -> None:
        self._programme = programme
        self._seed = seed
        self._held = [self._segment(0, 0)]

    def rows(self, first: int, count: int) -> NDArray[np.float64]:
        """Rows ``first`` to ``first + count`` (10 ms each, from power-on), shape (count, 7)."""
        if first < self._held[0].start:  # the craft was powered on anew
            self._held = [self._segment(0, 0)]
        parts, end = [], first + count
        while first < end:
            last = self._held[-1]
            if first >= last.end:
                self._held = [last, self._segment(last.number + 1, last.end)]
                continue
            held = next(one for one in self._held if first < one.end)
            parts.append(held.table[first - held.start : end - held.start])
            first += len(parts[-1])
        return np.concatenate(parts)

    def _segment(self, number: int, start: int) -> _Held:
        """The segment of that running number, which counts repetitions on, from a tick on. Behind
        the last of all the motors are off, for an hour at a time."""
        segments, repeat = self._programme.segment, self._programme.repeat
        place, behind = number, number - len(segments)
        if behind >= 0:
            if repeat is None:
                return _Held(number, start, _idle(round(3600.0 / TICK_S)))
            place = repeat + behind % (len(segments) - repeat)
        segment = segments[place]
        generator = np.random.default_rng((self._seed, number))
        table = _segment_rows(segment, round(segment.seconds / TICK_S), generator)
        return _Held(number, start, table)


_COLUMN = {
    "roll": ROW_ROLL,
    "pitch": ROW_PITCH,
    "yaw": ROW_YAW,
    "height": ROW_LEVEL,
    "collective": ROW_PUSH,
    "thrust": ROW_LEVEL,
}


def _idle(count: int) -> NDArray[np.float64]:
    rows = np.zeros((count, ROW_COLUMNS))
    rows[:, ROW_MODE] = FREE
    rows[:, ROW_THRUST] = THRUST_OFF
    return rows


def _segment_rows(
    segment: Segment, ticks: int, generator: np.random.Generator
) -> NDArray[np.float64]:
    rows = _idle(ticks)
    if segment.kind == "fly":
        rows[:, ROW_THRUST] = THRUST_HEIGHT
        rows[:, ROW_LEVEL] = segment.height_m
        rows[:, ROW_KEEP] = segment.keep
    elif segment.kind == "bench":
        rows[:, ROW_MODE] = FIXED
        rows[:, ROW_THRUST] = THRUST_DIRECT
        rows[:, ROW_LEVEL] = segment.thrust
    elif segment.kind == "hand":
        rows[:, ROW_MODE] = HELD
    time = np.arange(ticks, dtype=np.float64) * TICK_S
    for excitation in segment.excite:
        end = segment.seconds if excitation.end_s is None else excitation.end_s
        inside = np.asarray((time >= excitation.start_s) & (time < end))
        window = end - excitation.start_s
        signal = _signal(excitation, time[inside] - excitation.start_s, window, generator)
        rows[inside, _COLUMN[excitation.axis]] += signal
    return rows


def _signal(
    excitation: Excitation,
    time: NDArray[np.float64],
    window: float,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    size, period = excitation.amplitude, excitation.period_s
    low, high = excitation.low_hz, excitation.high_hz
    if excitation.shape == "step":
        return np.full(len(time), size)
    if excitation.shape == "doublet":
        place = np.mod(time / period + 1e-9, 1.0)
        return size * np.select([place < 1 / 3, place < 2 / 3], [1.0, -1.0], 0.0)
    if excitation.shape == "sine":
        return size * np.sin(2 * math.pi * time / period)
    if excitation.shape == "chirp":
        sweep = low * time + (high - low) * time**2 / (2 * max(window, 1e-9))
        return size * np.sin(2 * math.pi * sweep)
    if excitation.shape == "trapeze":
        corners = np.array([0.0, 0.15, 0.35, 0.65, 0.85, 1.0]) * window
        levels = np.array([0.0, 1.0, 1.0, -1.0, -1.0, 0.0]) * size
        # A raised cosine between the corners: a hand neither starts nor stops with a jerk.
        index = np.clip(np.searchsorted(corners, time, side="right") - 1, 0, 4)
        share = (time - corners[index]) / (corners[index + 1] - corners[index])
        smooth = 0.5 - 0.5 * np.cos(math.pi * share)
        return levels[index] + (levels[index + 1] - levels[index]) * smooth
    if excitation.shape == "multisine":
        lines = np.geomspace(low, high, 8)
        phases = generator.uniform(0, 2 * math.pi, len(lines))
        waves = np.sin(2 * math.pi * lines[:, None] * time + phases[:, None])
        return size * waves.sum(0) / math.sqrt(len(lines) / 2)
    levels = generator.uniform(-size, size, int(window / period) + 2)
    return levels[(time / period + 1e-9).astype(int)]


def _excite(axis: Axis, shape: Shape, amplitude: float, **more: float) -> Excitation:
    return Excitation(axis=axis, shape=shape, amplitude=amplitude, **more)


def _segment(kind: Kind, seconds: float, *excite: Excitation, **more: float) -> Segment:
    return Segment(kind=kind, seconds=seconds, excite=excite, **more)


def _programme(name: str, *segments: Segment, repeat: int | None = None) -> Programme:
    return Programme(name=name, segment=segments, repeat=repeat)


_TAKE_OFF = (_segment("rest", 4.0), _segment("fly", 5.0))
_EXCITE = (
    _segment("fly", 6.0, _excite("roll", "doublet", 9.0, period_s=1.5)),
    _segment("fly", 6.0, _excite("pitch", "doublet", 9.0, period_s=1.5)),
    _segment("fly", 6.0, _excite("yaw", "doublet", 90.0, period_s=1.5)),
    _segment(
        "fly",
        12.0,
        _excite("roll", "random", 9.0, period_s=0.35),
        _excite("pitch", "random", 9.0, period_s=0.35),
        _excite("yaw", "random", 80.0, period_s=0.5),
        _excite("height", "random", 0.15, period_s=2.0),
    ),
    _segment("fly", 4.0),
)
_MOVED = _segment(
    "bench",
    60.0,
    _excite("thrust", "random", 14000.0, period_s=0.4),
    _excite("thrust", "multisine", 3000.0, low_hz=0.1, high_hz=2.0),
    thrust=33000.0,
)
_TURNED = _segment(
    "hand",
    20.0,
    _excite("roll", "trapeze", 50.0, start_s=1.0, end_s=9.0),
    _excite("pitch", "trapeze", 40.0, start_s=4.0, end_s=14.0),
    _excite("yaw", "trapeze", 70.0, start_s=7.0, end_s=18.0),
)
_LANDING = (_segment("fly", 4.0, height_m=0.0), _segment("rest", 3.0))
_EACH_AXIS = (
    _segment("hand", 5.0, _excite("roll", "trapeze", 40.0)),
    _segment("hand", 5.0, _excite("pitch", "trapeze", 40.0)),
    _segment("hand", 5.0, _excite("yaw", "trapeze", 60.0)),
)
_STILL = _segment("hand", 4.0)

BUILT_IN: dict[str, Programme] = {
    one.name: one
    for one in (
        # Take off, hover, then move each axis and all together, for ever.
        _programme("excite", *_TAKE_OFF, *_EXCITE, repeat=2),
        _programme("hover", *_TAKE_OFF, repeat=1),
        # For clients: stands with motors off until somebody commands.
        _programme("wait", _segment("rest", 10.0), repeat=0),
        # Thesis 7.3.3: 30 s still, take off, hover, all axes, land.
        _programme(
            "thesis_flight", _segment("rest", 30.0), _segment("fly", 5.0), *_EXCITE, *_LANDING
        ),
        # For clients: fixed on the bench, motors off until somebody commands.
        _programme("bench", _segment("bench", 10.0), repeat=0),
        # Thesis 7.2.1: fixed on the bench, thrust moved arbitrarily.
        _programme("motor_bench", _segment("rest", 4.0), _MOVED, repeat=1),
        # Thesis 6.2.2: picked up, turned by hand, put back to the same place.
        _programme("hand_rotation", _STILL, _TURNED, _segment("hand", 6.0)),
        # Thesis 6.3: about roll, then pitch, then yaw, positive first.
        _programme("axis_check", _STILL, *_EACH_AXIS, _segment("hand", 3.0)),
    )
}
