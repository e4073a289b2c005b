"""The gap: how far a model predicts wrong 20 and 50 ms ahead, beside what noise alone would do.

An unstable craft cannot be simulated freely over a flight, so the model starts afresh from what
was measured at every row and is judged 20 and 50 ms later. The gap of a channel is the RMS of
these errors over both horizons, divided by the channel's noise floor (``floor``): 1.0 says that
nothing is left to explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.channels import CHANNELS
from groundstation.comparison.regimes import Motion, motion_of
from groundstation.dynamics.model import Model, Turning
from groundstation.identification.arx.workflow import with_arx_attitude
from groundstation.identification.runs import Run, without_gaps
from groundstation.prediction.drive import fresh_rhythm, fresh_rows
from groundstation.prediction.observer import Noise
from groundstation.prediction.prediction import (
    Ahead,
    observe_as_it_is,
    observe_run,
    own_noise,
    predict_observed,
)
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

HORIZONS_S = (0.02, 0.05)
FURTHER_S = (0.2, 0.5)
"""Where an observer that follows what is slow helps little and physics shows."""
FURTHER_EVERY_S = 0.02
"""Rows from which predictions that far start: neighbours share nearly all of what they fly over."""
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
    """Prediction errors of one model on one run, measured less predicted, SI, all (n, 9) in the
    order of ``CHANNELS`` and in the row they are judged at.

    recorded: the run as it is, run: lost rows filled in. noise: its own, and chosen: what of it
    foretells the run better with this model (``observe_as_it_is``). step: at the shortest
    horizon, ``step_rows`` (9,): one row, but more where the attitude is refreshed every few rows.
    horizons: one for each that was asked for, which are ``rows`` (9,) each. NaN where the first or
    last row is outside flight or was not measured afresh.
    """

    recorded: Run
    run: Run
    motion: Motion
    noise: Noise
    chosen: Noise
    step_rows: NDArray[np.int64]
    step: Array
    horizons: tuple[Array, ...]
    rows: tuple[NDArray[np.int64], ...]


def ahead_errors(
    run: Run,
    model: Model,
    rows_judged: slice | None = None,
    *,
    motion: Motion | None = None,
    like: AheadErrors | None = None,
    same_observer: bool = False,
    turning: Turning = "body",
    every_s: float = 0.0,
    horizons_s: Sequence[float] = HORIZONS_S,
) -> AheadErrors:
    """Errors of ``model`` on a run (lost rows as NaN) at the shortest horizon and ``horizons_s``.

    rows_judged: only these; the rows before tell the state. motion: of this model, where it is
    known. like: of another model on the same run, so that the same rows are judged, with the same
    noise of the run's sensors (``own_noise``). same_observer: with what was chosen of it for that
    model. turning: what of the model turns the craft. every_s: predictions start no more often than
    that, where rows are faster.

    Raises BadInputError where PWM, battery voltage or gyro are missing throughout.
    """
    whole = without_gaps(run) if like is None else like.run
    moved = like.motion if like is not None else motion or motion_of(whole, model)
    flown = moved.flown
    if rows_judged is not None:
        inside = np.zeros(len(run), bool)
        inside[rows_judged] = True
        moved = replace(moved, flown=flown & inside)
    rhythm, fresh = fresh_rhythm(whole.attitude).stride, fresh_rows(whole.attitude)
    known = np.isfinite(_measured(run)) & moved.flown[:, None]
    known[:, ATTITUDE] &= fresh[:, None]
    step_rows = np.array([1] * 6 + [rhythm] * 3)
    ends = [max(round(horizon / run.period_s), rhythm) for horizon in horizons_s]
    rows = tuple(np.array([count] * 6 + [count - count % rhythm] * 3) for count in ends)
    # The model flies on every input; what was not measured afresh must not look measured.
    shown = np.where(fresh[:, None], run.attitude, np.nan)
    inputs = {name: getattr(whole, name) for name in ("duty", "duty_step", "supply_v")}
    driven = replace(run, **inputs, attitude=shown)
    counts = np.unique(np.concatenate([step_rows, *rows]))
    noise = own_noise(driven, flown) if like is None else like.noise
    if like is not None and same_observer:
        seen, chosen = observe_run(model, driven, noise=like.chosen), like.chosen
    else:
        seen, chosen = observe_as_it_is(model, driven, noise)
    ahead = predict_observed(driven, seen, counts, stride=_stride(every_s, run.period_s))
    if turning == "arx":
        ahead = with_arx_attitude(ahead, model, whole)
    step, *horizons = _where_judged(ahead, driven, known, (step_rows, *rows))
    return AheadErrors(run, whole, moved, noise, chosen, step_rows, step, tuple(horizons), rows)


def _where_judged(
    ahead: Ahead, run: Run, known: NDArray[np.bool_], wanted: Sequence[NDArray[np.int64]]
) -> list[Array]:
    """Errors (n, 9) so many rows ahead, for each of ``wanted`` (9,), in the row they are judged at.

    known: (n, 9), what can be judged, and begun at.
    """
    made, found = ahead.errors(run), []
    for rows in wanted:
        error = np.full(known.shape, np.nan)
        for part in (slice(0, 6), ATTITUDE):
            count = int(rows[part][0])
            at = ahead.rows + count
            values = made[:, int(np.searchsorted(ahead.horizons, count)), part]
            error[at, part] = np.where(known[at, part] & known[ahead.rows, part], values, np.nan)
        found.append(error)
    return found


def _stride(every_s: float, period_s: float) -> int:
    """Odd, so that angles that are new in every second or fourth row are met all the same; as
    many at 499.9 rows a second as at 500."""
    rows = max(round(every_s / period_s), 1)
    return rows - (rows % 2 == 0)


def pooled_rms(errors: Sequence[Array]) -> Array:
    """RMS (9,) over runs and horizons (n, 9); NaN for a channel without a value, infinite for one
    of which predictions grow without end."""
    squares, counts = np.zeros(9), np.zeros(9)
    for error in errors:
        with np.errstate(over="ignore"):
            squares += np.nansum(np.square(error), axis=0)
        counts += np.isfinite(error).sum(axis=0)
    return np.sqrt(np.divide(squares, counts, out=np.full(9, np.nan), where=counts > 0))


def overall(rms: Array, floor: Array) -> float:
    """One number for all channels: root mean square of error over noise floor, (channels,)."""
    ratio = np.divide(rms, floor, out=np.full(len(rms), np.nan), where=floor > 0)
    known = ~np.isnan(ratio)
    return float(np.sqrt(np.mean(ratio[known] ** 2))) if known.any() else float("nan")


def _measured(run: Run) -> Array:
    return np.hstack([run.gyro, run.accelerometer, run.attitude])
