"""The gap: how far a model predicts wrong 20 and 50 ms ahead, beside what noise alone would do.

An unstable craft cannot be simulated freely over a flight, so the model starts afresh from what
was measured at every row and is judged 20 and 50 ms later. The gap of a channel is the RMS of
these errors over both horizons, divided by the channel's noise floor (``floor``): 1.0 says that
nothing is left to explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.ahead import base_ahead
from groundstation.discrepancy.findings import CHANNELS
from groundstation.discrepancy.regimes import Motion, motion_of
from groundstation.dynamics.model import Model
from groundstation.identification.runs import Run
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

HORIZONS_S = (0.02, 0.05)
GYRO, ACCELEROMETER, ATTITUDE = slice(0, 3), slice(3, 6), slice(6, 9)
UNITS = {
    **dict.fromkeys(CHANNELS[GYRO], "deg/s"),
    **dict.fromkeys(CHANNELS[ACCELEROMETER], "g"),
    **dict.fromkeys(CHANNELS[ATTITUDE], "deg"),
}
PER_SI = np.array([180 / np.pi] * 3 + [1 / STANDARD_GRAVITY] * 3 + [180 / np.pi] * 3)
"""Unit of ``UNITS`` per SI unit, by channel."""


@dataclass(frozen=True, slots=True)
class AheadErrors:
    """Prediction errors of one model on one run.

    measured: (n, 9) in the order of ``CHANNELS``, SI. step_rows: (9,) rows of the shortest
    horizon of each channel: 1, but where the attitude is refreshed every second row only, 2.
    step: (n, 9) errors at that horizon, horizons: one (n, 9) for each of ``HORIZONS_S``;
    measured less predicted, in the row they are judged at, NaN where there is no prediction or
    no fresh measurement.
    """

    run: Run
    motion: Motion
    measured: Array
    step_rows: NDArray[np.int64]
    step: Array
    horizons: tuple[Array, ...]
    rows: tuple[NDArray[np.int64], ...]


def ahead_errors(run: Run, model: Model) -> AheadErrors:
    """Errors of ``model`` on a run at the shortest horizon, 20 and 50 ms.

    Raises BadInputError where PWM, battery voltage or gyro are missing.
    """
    motion = motion_of(run, model)
    measured = np.hstack([run.gyro, run.accelerometer, run.attitude])
    fresh, every = fresh_attitude(run.attitude)
    usable = np.repeat(motion.flown[:, None], 9, axis=1)
    usable[:, ATTITUDE] &= fresh[:, None]
    step_rows = np.array([1] * 6 + [every] * 3)
    made = [step_rows]
    for horizon in HORIZONS_S:
        count = max(round(horizon / run.period_s), every)
        made.append(np.array([count] * 6 + [count - count % every] * 3))
    cache: dict[int, Array] = {}
    errors = []
    for rows in made:
        error = np.full((len(run), 9), np.nan)
        for part in (slice(0, 6), ATTITUDE):
            count = int(rows[part][0])
            if count not in cache:
                cache[count] = measured - base_ahead(run, motion, count)
            start = np.zeros_like(usable[:, part])
            start[count:] = usable[:-count, part]
            valid = usable[:, part] & start
            error[:, part] = np.where(valid, cache[count][:, part], np.nan)
        errors.append(error)
    return AheadErrors(
        run, motion, measured, step_rows, errors[0], tuple(errors[1:]), tuple(made[1:])
    )


def fresh_attitude(attitude: Array) -> tuple[Mask, int]:
    """(rows (n,) with a new attitude, rows from one to the next: 1 or 2).

    The firmware refreshes the angles at 250 Hz and sends each of them twice.
    """
    if not np.isfinite(attitude).all():
        return np.zeros(len(attitude), bool), 1
    new = np.concatenate([[False], (np.diff(attitude, axis=0) != 0).any(axis=1)])
    odd, even = new[1::2].mean(), new[0::2].mean()
    if min(odd, even) > 0.25 or max(odd, even) < 0.25:
        return np.ones(len(attitude), bool), 1
    fresh = np.zeros(len(attitude), bool)
    fresh[int(odd > even) :: 2] = True
    return fresh, 2


def pooled_rms(errors: Sequence[Array], rows: Mask | None = None) -> Array:
    """RMS (9,) over all horizons of one run, in the given rows; NaN where there is nothing."""
    squares, counts = np.zeros(9), np.zeros(9)
    for error in errors:
        part = error if rows is None else error[rows]
        squares += np.nansum(np.square(part), axis=0)
        counts += np.isfinite(part).sum(axis=0)
    return np.sqrt(np.divide(squares, counts, out=np.full(9, np.nan), where=counts > 0))
