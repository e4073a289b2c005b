"""Compiled shift of the rotors' speeds to the time at which the outputs show them."""

from __future__ import annotations

import math
from typing import Any

from numba import njit


@njit(nogil=True, cache=True, error_model="numpy")
def shifted_rotors(
    square: Any, end: Any, first: int, rows: float, period: float, mean: Any, spin: Any, up: Any
) -> None:
    """What acted over each row's period, ``rows`` rows earlier.

    square, end: (n, 4) (rev/s)^2, mean over the period that ends with a row, and at the row.
    first: the row of the result's first. Fills mean (k, 4): the integral of the square is known
    at every row with its slope, so it is interpolated by cubics; spin (k,) in the period's
    middle and up (k,), its slope: rotor sum -n1 + n2 - n3 + n4 in rev/s and rev/s^2.
    """
    last = len(end) - 1
    for k in range(len(mean)):
        at = first + k - rows
        for i in range(4):
            mean[k, i] = _between(square, end, i, at - 1.0, at, last)
        spin[k] = _spin(end, at - 0.5, last)
        up[k] = (_spin(end, at, last) - _spin(end, at - 1.0, last)) / period


@njit(nogil=True, error_model="numpy", inline="always")
def _between(square: Any, end: Any, i: int, start: float, stop: float, last: int) -> float:
    """Integral of the square, in rows, from one place to another at most one row later."""
    start, stop = min(max(start, 0.0), float(last)), min(max(stop, 0.0), float(last))
    k, other = min(int(start), last - 1), min(int(stop), last - 1)
    if k == other:
        return _within(square, end, i, k, stop - k) - _within(square, end, i, k, start - k)
    rest = square[k + 1, i] - _within(square, end, i, k, start - k)
    return rest + _within(square, end, i, other, stop - other)


@njit(nogil=True, error_model="numpy", inline="always")
def _within(square: Any, end: Any, i: int, k: int, t: float) -> float:
    """Integral from row k to the place t of a row further: a cubic with known ends and slopes."""
    rise = end[k, i] * t * (1.0 - t) * (1.0 - t) + end[k + 1, i] * t * t * (t - 1.0)
    return square[k + 1, i] * t * t * (3.0 - 2.0 * t) + rise


@njit(nogil=True, error_model="numpy", inline="always")
def _spin(end: Any, at: float, last: int) -> float:
    """The rotor sum between rows, held beyond the ends."""
    place = min(max(at, 0.0), float(last))
    k = min(int(place), last - 1)
    share = place - k
    total, sign = 0.0, -1.0
    for i in range(4):
        one, other = math.sqrt(end[k, i]), math.sqrt(end[k + 1, i])
        total += sign * (one + share * (other - one))
        sign = -sign
    return total
