"""The gap: how far a model predicts wrong, by channel and regime, beside what noise alone
would do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effect import SPIN
from groundstation.dynamics.model import Model, Turning, model_vehicle, rotor_motors
from groundstation.dynamics.simulation import REVOLUTION
from groundstation.identification.arx import with_arx_attitude
from groundstation.identification.flight import flights_in, velocity_of
from groundstation.identification.runs import (
    SATURATED,
    RotorSquares,
    Run,
    rotor_squares,
    without_gaps,
)
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

# The measured channels that a model is held against, in the order of every table and report.


CHANNELS = (
    "gyro_x",
    "gyro_y",
    "gyro_z",
    "accelerometer_x",
    "accelerometer_y",
    "accelerometer_z",
    "roll",
    "pitch",
    "yaw",
)


# Regimes of a flight: which rows hover, turn fast, climb, saturate. A row can be in several.


Mask = NDArray[np.bool_]

WHOLE = "whole flight"
STRONGEST = 0.85
"""A motion is strong in the rows above this quantile of its size in the flight."""
NEAR_GROUND_S = 1.5
AFTER_S = 0.3
LOW_BATTERY_V = 3.3


@dataclass(frozen=True, slots=True)
class Motion:
    """What a run did, as the base model and the sensors have it.

    squares: rotors behind the run. torque: (n, 3) modelled angular acceleration, rad/s^2.
    thrust: (n,) modelled specific force along z, m/s^2. velocity: (n, 3) forward, left, up in the
    body, m/s (``identification.flight``: steady speed is forgotten); zero without accelerometer
    or attitude. spin: (n,) -n1+n2-n3+n4 in rad/s. flown: (n,) airborne.
    since_start_s, before_end_s: (n,) time to the ends of the flight, infinite where the recording
    does not show them.
    """

    squares: RotorSquares
    torque: Array
    thrust: Array
    velocity: Array
    spin: Array
    flown: Mask
    since_start_s: Array
    before_end_s: Array


def motion_of(run: Run, model: Model) -> Motion:
    """The motion of a run under the model's motors and body.

    Raises BadInputError where PWM or battery voltage are missing, ValueError where the model has
    no body.
    """
    body = model.body
    if body is None:
        raise ValueError("the model has no body constants")
    squares = rotor_squares(run, rotor_motors(model))
    mixed = squares.mixed(model_vehicle(model).configuration)
    torque = mixed * [body.c0, body.c1, body.c2]
    thrust = np.asarray(body.thrust_per_mass * squares.end.sum(axis=1), np.float64)
    spin = np.asarray(REVOLUTION * np.sqrt(squares.end) @ SPIN, np.float64)
    flown = np.zeros(len(run), np.bool_)
    since, before = np.full(len(run), np.inf), np.full(len(run), np.inf)
    for one in flights_in(run):
        flown[one.first : one.last] = True
        rows = np.arange(one.start, one.stop)
        if one.rests[0]:
            since[rows] = (rows - one.first) * run.period_s
        if one.rests[1]:
            before[rows] = (one.last - rows) * run.period_s
    return Motion(squares, torque, thrust, velocity_of(run), spin, flown, since, before)


def regimes_of(run: Run, motion: Motion) -> dict[str, Mask]:
    """Regime -> rows (n,) in which it holds; all within the flown rows.

    A regime that needs a channel the run lacks, or never occurs, has no row.
    """
    flown = motion.flown
    rate, torque = run.gyro, motion.torque
    tilt = np.hypot(run.attitude[:, 0], run.attitude[:, 1])
    speed = np.hypot(motion.velocity[:, 0], motion.velocity[:, 1])
    slope = np.gradient(motion.thrust, run.period_s)
    spin_up = np.gradient(motion.spin, run.period_s)
    slowing = -np.gradient(np.sqrt(motion.squares.end), run.period_s, axis=0).min(axis=1)
    fast_tilt = np.hypot(rate[:, 0], rate[:, 1])
    torque_tilt = np.hypot(torque[:, 0], torque[:, 1])
    ground = np.minimum(motion.since_start_s, motion.before_end_s) < NEAR_GROUND_S
    duty = run.duty
    with np.errstate(invalid="ignore"):
        masks = {
            "hover": (fast_tilt < 0.35)
            & (np.abs(rate[:, 2]) < 0.35)
            & (tilt < 0.07)
            & (np.abs(motion.velocity[:, 2]) < 0.15)
            & ~ground,
            "high roll or pitch rate": _strong(fast_tilt, flown, 0.4),
            "high yaw rate": _strong(np.abs(rate[:, 2]), flown, 0.3),
            "turning about several axes": _strong(fast_tilt * np.abs(rate[:, 2]), flown, 0.2),
            "roll or pitch torque": _strong(torque_tilt, flown, 4.0),
            "after yaw commands": _after(_strong(np.abs(torque[:, 2]), flown, 0.5), run),
            "rotor acceleration": _strong(np.abs(spin_up), flown, 300.0),
            "rotors slowing down": _strong(slowing, flown, 60.0),
            "thrust change": _strong(np.abs(_smooth(slope, 5)), flown, 2.0),
            "high thrust": _above(motion.thrust, flown, 1.06),
            "low thrust": _above(-motion.thrust, flown, -0.94),
            "tilted": _strong(tilt, flown, 0.08),
            "translation": _strong(speed, flown, 0.25),
            "climb": _strong(np.maximum(motion.velocity[:, 2], 0.0), flown, 0.1),
            "descent": _strong(np.maximum(-motion.velocity[:, 2], 0.0), flown, 0.1),
            "near ground": ground,
            "saturation": ((duty >= SATURATED) | (duty <= 0.01)).any(axis=1),
            "low battery": run.supply_v < LOW_BATTERY_V,
        }
    return {WHOLE: flown.copy()} | {name: mask & flown for name, mask in masks.items()}


def _strong(size: Array, flown: Mask, least: float) -> Mask:
    """Rows in which a size (n,) is among its largest in flight, and worth the name at all."""
    if not flown.any() or not np.isfinite(size).all():
        return np.zeros(len(size), bool)
    return size > max(least, float(np.quantile(size[flown], STRONGEST)))


def _above(thrust: Array, flown: Mask, share: float) -> Mask:
    """Rows whose thrust is beyond a share of the flight's median, in the sign of ``share``."""
    if not flown.any():
        return np.zeros(len(thrust), bool)
    usual = float(np.median(np.abs(thrust[flown])))
    return _strong(thrust, flown, share * usual)


def _after(strong: Mask, run: Run) -> Mask:
    """Rows at most 0.3 s after the given ones."""
    rows = round(AFTER_S / run.period_s)
    count = np.cumsum(np.concatenate([[0], strong.astype(np.int64)]))
    index = np.arange(1, len(strong) + 1)
    return count[index] > count[np.maximum(index - rows, 0)]


def _smooth(signal: Array, rows: int) -> Array:
    """Centred mean over ``2 rows + 1`` rows."""
    return np.convolve(signal, np.full(2 * rows + 1, 1.0 / (2 * rows + 1)), mode="same")


# The gap: how far a model predicts wrong 20 and 50 ms ahead, beside what noise alone would do.
#
# An unstable craft cannot be simulated freely over a flight, so the model starts afresh from what
# was measured at every row and is judged 20 and 50 ms later. The gap of a channel is the RMS of
# these errors over both horizons, divided by the channel's noise floor (``floor``): 1.0 says that
# nothing is left to explain.


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
    last row is outside flight or was not measured afresh. begun: (m,) rows from which predictions
    start, one of ``stride`` that are settled and in the air.
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
    begun: NDArray[np.int64]
    stride: int

    def begun_every(self, every_s: float) -> AheadErrors | None:
        """The same of predictions that start no more often than that; None where these start more
        seldom than in every row."""
        if self.stride != 1:
            return None
        stride = _stride(every_s, self.run.period_s)
        begun = self.begun[::stride]

        def kept(errors: Array, rows: NDArray[np.int64]) -> Array:
            found = np.full_like(errors, np.nan)
            for part in (slice(0, 6), ATTITUDE):
                at = begun + int(rows[part][0])
                found[at, part] = errors[at, part]
            return found

        horizons = tuple(map(kept, self.horizons, self.rows))
        step = kept(self.step, self.step_rows)
        return replace(self, step=step, horizons=horizons, begun=begun, stride=stride)


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
    stride = _stride(every_s, run.period_s)
    ahead = predict_observed(driven, seen, counts, stride=stride)
    if turning == "arx":
        ahead = with_arx_attitude(ahead, model, whole)
    step, *horizons = _where_judged(ahead, driven, known, (step_rows, *rows))
    known_of = run, whole, moved, noise, chosen, step_rows, step, tuple(horizons), rows
    return AheadErrors(*known_of, ahead.rows, stride)


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
