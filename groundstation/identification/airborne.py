"""Which rows of a run are in the air, told from motors, accelerometer and attitude alone.

A flight begins where its motors begin to turn and ends where they stop, or where the recording
does. In between it is airborne from where the ground carries nothing to where it begins to: by
height, where a rest on the ground tells it (``prediction.height``), otherwise by time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.runs import Run
from groundstation.prediction.drive import CLEAR_M, TURNING, heights_of, lifting, rise_of, struck
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import spans

Mask = NDArray[np.bool_]

TURNING_REV_S = 20.0
"""Measured speed from which a rotor turns; in flight it is ten times that."""
SETTLE_S = 0.5
"""A flight that is recorded from the air on loses this: the motors forget their unknown start."""
LANDING_CLEAR_M = 0.05
"""``CLEAR_M`` at a landing, where height is less well known."""
TAKE_OFF_S, CONTACT_S = 1.5, 1.0
"""Left out at the start and at the end where height cannot be told; the ground may carry part of
the torque."""
DRIVEN_ON_S, BEFORE_IMPACT_S = 1.0, 0.02
"""How long motors may turn on after the craft has struck the ground, and by how much earlier a
filtered or interpolated accelerometer shows it."""
SHAKEN = 1.5
"""An impact is beyond so many times the largest acceleration before: rotors shake an unfiltered
accelerometer by 1 g and more."""
REST_S = 0.2
TOUCH_DOWN_S = 0.6
"""From when the motors stop until the craft lies still: it may fall the last bit."""


@dataclass(frozen=True, slots=True)
class Air:
    """One flight within a run.

    start, stop: rows in which the motors turn. first, last: of these, the airborne ones. rests:
    whether it began and ended on the ground within the run. height_m: (n,) above the take-off
    point where it can be told, otherwise infinite. maybe_low: rows before ``last`` in which it may
    have landed where the recording breaks off (``prediction.height``): for whoever looks for what
    the ground does.
    """

    start: int
    stop: int
    first: int
    last: int
    rests: tuple[bool, bool]
    height_m: Array
    maybe_low: int


def turning(run: Run) -> Mask:
    """Rows (n,) in which all motors turn: by what drives them, or by their speed without that."""
    if np.isfinite(run.duty).any():
        return np.asarray((run.duty > TURNING).all(axis=1))
    return np.asarray((run.rotor_rev_s > TURNING_REV_S).all(axis=1))


def turning_parts(run: Run, least_s: float) -> list[Run]:
    """The stretches of a run in which all motors turn, those that last ``least_s``."""
    return [run[a:b] for a, b in spans(turning(run)) if (b - a) * run.period_s >= least_s]


def airborne(run: Run) -> Mask:
    """Rows (n,) in the air."""
    mask = np.zeros(len(run), np.bool_)
    for one in flights_in(run):
        mask[one.first : one.last] = True
    return mask


def flights_in(run: Run) -> list[Air]:
    """The flights of a run without missing rows, in order; those never in the air are left out."""
    period, has_accelerometer = run.period_s, bool(np.isfinite(run.accelerometer).any())
    driven = run.duty if np.isfinite(run.duty).any() else run.rotor_rev_s
    still = np.asarray((driven <= 0.0).all(axis=1))
    found = []
    for begun, ended in spans(turning(run)):
        start, stop = lifting(driven, begun, ended, period)
        still[begun:start] = True
        rests = (start * period > REST_S, (len(run) - stop) * period > TOUCH_DOWN_S)
        height, maybe_low = np.full(len(run), np.inf), 0
        if has_accelerometer:
            has_attitude = bool(np.isfinite(run.attitude).any())
            level = run.attitude if has_attitude else np.zeros((len(run), 3))
            rise = rise_of(level, run.accelerometer)
            height[start:stop], maybe_low = heights_of(rise, still, start, stop, period)
        first, last = _clear_of_ground(period, start, stop, rests, height)
        if has_accelerometer:
            late = max(first, stop - round(DRIVEN_ON_S / period))
            hit = struck(rise, late, stop, SHAKEN * float(rise[first:late].max(initial=0.0)))
            last = last if hit is None else min(last, hit - round(BEFORE_IMPACT_S / period))
        if rests[1]:
            last, maybe_low = min(last, stop - maybe_low), 0
        if last > first:
            low = min(maybe_low, last - first)
            found.append(Air(start, stop, first, last, rests, height, low))
    return found


def _clear_of_ground(
    period: float, start: int, stop: int, rests: tuple[bool, bool], height: Array
) -> tuple[int, int]:
    """From where the ground carries nothing to where it begins to.

    What is low after the take-off may be a low hover; it ends no flight.
    """
    first, last = start, stop
    if not rests[0]:
        first += round(SETTLE_S / period)
    else:
        clear = np.flatnonzero(height[start:stop] > CLEAR_M)
        known = np.isfinite(height[start])
        if known and not len(clear):
            return start, start
        first += int(clear[0]) if len(clear) and known else round(TAKE_OFF_S / period)
    if rests[1]:
        clear = np.flatnonzero(height[first:stop] > LANDING_CLEAR_M)
        known = np.isfinite(height[stop - 1])
        last = first + int(clear[-1]) + 1 if len(clear) and known else stop
        if not known:
            last -= round(CONTACT_S / period)
    return first, last
