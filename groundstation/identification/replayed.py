"""An identified model on recorded inputs: what it would have measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import Model, Turning
from groundstation.dynamics.sensors import shown_rotors
from groundstation.errors import BadInputError
from groundstation.identification.arx.flight import with_arx_attitude
from groundstation.identification.runs import Run, require_known
from groundstation.prediction.prediction import SETTLE_S, fly_ahead, observe_run
from groundstation.report.page import Result
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

CHANNELS = (
    *(f"gyro {axis} (deg/s)" for axis in "xyz"),
    *(f"accelerometer {axis} (g)" for axis in "xyz"),
    *(f"{axis} (deg)" for axis in ("roll", "pitch", "yaw")),
)


@dataclass(frozen=True, slots=True, repr=False)
class Replayed(Result):
    """Modelled channels of a run, row by row, as the telemetry would report them.

    gyro: (n, 3) rad/s. accelerometer: (n, 3) m/s^2. attitude: (n, 3) rad, yaw unwrapped.
    rotor_rev_s: (n, 4). flown: (n,) rows that were simulated; the others, on the ground or of a
    window that began there, repeat what was measured. run: what was measured.
    """

    gyro: Array
    accelerometer: Array
    attitude: Array
    rotor_rev_s: Array
    flown: NDArray[np.bool_]
    run: Run
    SHOWN_BY: ClassVar[str] = "groundstation.identification.shown:replayed"

    def _what(self) -> str:
        share = 100.0 * float(self.flown.mean())
        return f"{self.run.name}: {len(self.flown)} samples, {share:.0f} % simulated"


def simulate_run(
    model: Model, run: Run, window_s: float = 0.5, turning: Turning = "body"
) -> Replayed:
    """Fly a body model, with its effects, on a run's PWM and battery voltage.

    The motors run through; every ``window_s`` the rest starts afresh from the state that was
    observed until then, because no model of an unstable craft can follow a flight for long. The
    row of a fresh start is the measured one. turning: what turns the craft, the body or the model's
    ARX polynomials, which start from what was measured.

    Raises BadInputError where the run lacks PWM, battery voltage, gyro or attitude.
    """
    require_known(run, ("duty", "supply_v", "gyro", "attitude"), "nothing can be flown without it")
    if window_s < run.period_s:
        raise BadInputError(f"window of {window_s} s is shorter than a row ({run.period_s:.4f} s)")
    seen = observe_run(model, run)
    gyro, accelerometer = run.gyro.copy(), run.accelerometer.copy()
    attitude = np.unwrap(run.attitude, axis=0)
    flown = np.zeros(len(run), np.bool_)
    rows = min(max(1, round(window_s / run.period_s)), len(run) - 1)
    starts = np.arange(0, len(run) - 1, rows)
    for group, ahead in ((starts[:-1], rows), (starts[-1:], len(run) - 1 - int(starts[-1]))):
        done = fly_ahead(run, seen, group, np.arange(1, ahead + 1))
        if turning == "arx":
            done = with_arx_attitude(done, model, run)
        at = group[:, None] + done.horizons
        real = seen.flying[at] & seen.flying[group][:, None]
        gyro[at[real]] = done.gyro[real]
        accelerometer[at[real]] = done.accelerometer[real]
        attitude[at[real]] = done.attitude[real]
        flown[at[real]] = True
    attitude = np.unwrap(attitude, axis=0)
    shown = shown_rotors(model, seen.drive.rotor_rev_s, run.period_s)
    return Replayed(gyro, accelerometer, attitude, shown, flown, run)


def angle_rms(model: Model, runs: Sequence[Run], window_s: float) -> Array:
    """RMS (3,) of roll, pitch, yaw in rad of free runs of ``window_s``, over what was flown: the
    errors of thesis Table 7.2, which does not say how long its runs were. The first of each
    recording is left out: the state it starts from is not observed yet.

    Raises BadInputError as ``simulate_run``, and where nothing was flown or a run diverges.
    """
    errors = []
    for run in runs:
        done = simulate_run(model, run, window_s)
        rows = np.flatnonzero(done.flown)
        rows = rows[rows > max(window_s, SETTLE_S) / run.period_s]
        turn = run.attitude[rows] - done.attitude[rows]
        if not np.isfinite(turn).all():
            raise BadInputError(f"{run.name}: free runs of {window_s:g} s end nowhere")
        errors.append(np.angle(np.exp(1j * turn)))
    every = np.vstack(errors)
    if not len(every):
        raise BadInputError("by the model's thrust the craft never leaves the ground")
    return np.sqrt(np.mean(np.square(every), axis=0))


def channels_of(gyro: Array, accelerometer: Array, attitude: Array) -> Array:
    """(n, 9) in the units of ``CHANNELS``."""
    return np.column_stack(
        [np.degrees(gyro), accelerometer / STANDARD_GRAVITY, np.degrees(attitude)]
    )


def errors_of(run: Run, done: Replayed) -> Array:
    """Measured less modelled, (n, 9) in the units of ``CHANNELS``; angles wrapped.

    NaN in rows that were not simulated.
    """
    error = channels_of(run.gyro, run.accelerometer, run.attitude)
    error -= channels_of(done.gyro, done.accelerometer, done.attitude)
    error[:, 6:] = (error[:, 6:] + 180.0) % 360.0 - 180.0
    error[~done.flown] = np.nan
    return error


def rms_of(errors: Array) -> Array:
    """Root mean square per channel over what is known, NaN where nothing is."""
    known = np.isfinite(errors)
    count = known.sum(axis=0)
    square = np.where(known, errors, 0.0) ** 2
    return np.where(count, np.sqrt(square.sum(axis=0) / np.maximum(count, 1)), np.nan)
