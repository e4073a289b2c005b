"""Linear filters of a recording's rows: sensors near rest, and the firmware's low-pass.

Both are exact for the input they are given: rates that change straight from row to row, or values
at the rows with straight lines between. A filter that is the same on each of three axes, and of
second order at most, runs on all three at once; any other by its matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from groundstation.telemetry.arrays import Array

FIRMWARE_HZ = 1000.0
"""Rate of the firmware's sensor loop."""
SAME = 1e-12
"""Rounding of the differences that laws are made linear by."""
RATES, FORCES = slice(0, 3), slice(3, 6)
AXES = 3


@dataclass(frozen=True, eq=False)
class NearRest:
    """One sensor near rest: ds/dt = a s + b u, shown = c s + d u + offset, u of (6,)."""

    a: Array
    b: Array
    c: Array
    d: Array
    offset: Array

    @cached_property
    def steady(self) -> tuple[Array, Array]:
        """Gain and lag (6, 6): over a ramp u the states follow as p u + a^-1 p du/dt."""
        if not self.a.size:
            return self.d, np.zeros((6, 6))
        return self.d + self.c @ self.still, -self.c @ solved(self.a, self.still)

    @cached_property
    def still(self) -> Array:
        """The states (s, 6) that steady inputs of 1 settle at."""
        return solved(self.a, -self.b)


def solved(matrix: Array, values: Array) -> Array:
    """The x of least squares of matrix x = values."""
    return np.asarray(np.linalg.lstsq(matrix, values, rcond=None)[0])


def behind_sensor(near: NearRest, part: slice, values: Array, first: int, period_s: float) -> Array:
    """Rows (n, 3) behind a sensor, exactly, from a start that has settled at row ``first``."""
    from groundstation.identification.likelihood.kernels import linear_filter

    matrix = _discrete(near, part == RATES, period_s)
    start = near.still[:, part] @ values[first]
    alike = _alike_on_axes(near, part == RATES, period_s)
    if alike is not None:
        return _on_axes(alike, start.reshape(-1, AXES), first, values)
    to, of = np.nonzero(np.abs(matrix) > SAME * np.abs(matrix).max())
    found = np.empty_like(values)
    rows = np.ascontiguousarray(values)
    linear_filter(to, of, matrix[to, of], start, first, rows, found)
    return found


def _on_axes(step: Array, start: Array, first: int, values: Array) -> Array:
    """Rows (n, 3) behind one filter on each axis: [s_k, y_k] = step [s_(k-1), u_k, u_(k-1)] with
    step (3, 4); start: (1 or 2, 3), what there is of its two states."""
    from groundstation.identification.likelihood.kernels import axes_filter

    begin, found = np.zeros((2, AXES)), np.empty((len(values), AXES))
    begin[: len(start)] = start
    axes_filter(step, begin, first, np.ascontiguousarray(values), found)
    return found


@lru_cache(maxsize=256)
def _alike_on_axes(near: NearRest, rates: bool, h: float) -> Array | None:
    """Of a filter whose states are those of three axes, one behind the other, and which is the same
    on each: its step of one axis (3, 4), the second state 0 where it has one; None of others."""
    matrix = _discrete(near, rates, h)
    states, more = divmod(len(near.a), AXES)
    if more or not 0 < states <= 2:
        return None
    rows = [np.arange(states + 1) * AXES + axis for axis in range(AXES)]
    columns = [np.arange(states + 2) * AXES + axis for axis in range(AXES)]
    parts = [matrix[np.ix_(to, of)] for to, of in zip(rows, columns, strict=True)]
    apart = matrix.copy()
    for to, of in zip(rows, columns, strict=True):
        apart[np.ix_(to, of)] = 0.0
    rounding = SAME * np.abs(matrix).max()
    other = max(float(np.abs(one - parts[0]).max()) for one in parts)
    if max(other, float(np.abs(apart).max())) > rounding:
        return None
    step = np.zeros((3, 4))
    step[np.ix_([*range(states), 2], [*range(states), 2, 3])] = parts[0]
    return step


@lru_cache(maxsize=256)
def _discrete(near: NearRest, rates: bool, h: float) -> Array:
    """M of [s_k, y_k] = M [s_(k-1), u_k, u_(k-1)] over a period h.

    Rates change straight from row to row: their slopes are held over each period, and what comes
    out are means over it. Forces are values at the rows with straight lines between them.
    """
    from scipy.linalg import expm

    part = RATES if rates else FORCES
    a, b, c, d = near.a, near.b[:, part], near.c[part], near.d[part, part]
    n, m = b.shape
    # exp of [[A h, B h, 0], [0, 0, I], [0, 0, 0]]: the states' answers to a held input and a ramp.
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n], block[:n, n : n + m] = a * h, b * h
    block[n : n + m, n + m :] = np.eye(m)
    whole = expm(block)
    keep, held, ramp = whole[:n, :n], whole[:n, n : n + m], whole[:n, n + m :]
    none = np.zeros((m, m))
    if rates:
        # A period changes s by h (A mean(s) + B u).
        mean = solved(a * h, np.hstack([keep - np.eye(n), held - b * h]))
        return np.block(
            [[keep, held, np.zeros((n, m))], [c @ mean[:, :n], c @ mean[:, n:] + d, none]]
        )
    return np.block([[keep, ramp, held - ramp], [c @ keep, c @ ramp + d, c @ (held - ramp)]])


def behind_firmware(
    values: Array, corner_hz: float, period_s: float, mean: bool, within: Array | None = None
) -> Array:
    """Rows (n, 3) behind the firmware's Butterworth filter, which runs at 1 kHz: means over the
    periods before them (mean), or values at the rows with straight lines between.

    within: (n, 3), how much more than the first half of a period the second has."""
    if within is None:
        step, still = _firmware_step(corner_hz, period_s, mean)
        return _on_axes(step, still[:, None] * values[:1], 0, values)
    from scipy.signal import lfilter

    b, a, steps = _butterworth(corner_hz, period_s)
    given = np.repeat(values, steps, axis=0)
    later = np.sign(np.arange(steps) - 0.5 * (steps - 1))
    given += 0.5 * np.tile(later, len(values))[:, None] * np.repeat(within, steps, axis=0)
    start = _settled(b, a)[:, None] * values[:1]
    out, _ = lfilter(b, a, given, axis=0, zi=start)
    return out.reshape(len(values), steps, -1).mean(axis=1)


@lru_cache(maxsize=32)
def _firmware_step(corner_hz: float, period_s: float, mean: bool) -> tuple[Array, Array]:
    """What a row makes of the filter's two states, its input and the one before: (3, 4), the states
    and what is shown; and the states (2,) that an input of 1 settles at."""
    from scipy.signal import lfilter

    b, a, steps = _butterworth(corner_hz, period_s)
    now = np.ones(steps) if mean else np.arange(1, steps + 1) / steps
    step = np.empty((3, 4))
    for column, (state, given) in enumerate(
        (((1.0, 0.0), 0.0 * now), ((0.0, 1.0), 0.0 * now), ((0.0, 0.0), now), ((0.0, 0.0), 1 - now))
    ):
        shown, step[:2, column] = lfilter(b, a, given, zi=state)
        step[2, column] = shown.mean() if mean else shown[-1]
    return step, _settled(b, a)


@lru_cache(maxsize=32)
def _butterworth(corner_hz: float, period_s: float) -> tuple[Array, Array, int]:
    """Coefficients b, a of second order, and how often the firmware filters in a row."""
    from scipy.signal import butter

    steps = max(round(FIRMWARE_HZ * period_s), 1)
    b, a = butter(2, corner_hz, fs=steps / period_s)
    return b, a, steps


def _settled(b: Array, a: Array) -> Array:
    """The filter's states (2,) after inputs of 1."""
    from scipy.signal import lfilter_zi

    return lfilter_zi(b, a)
