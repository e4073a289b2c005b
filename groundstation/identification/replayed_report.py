"""Pages on simulated flights: a model against a recording, or along a reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.replayed import Replayed
from groundstation.identification.runs import Run
from groundstation.prediction.reference_flight import MadeRun
from groundstation.report.figure import figure, legend_above, thinned
from groundstation.report.page import Page
from groundstation.report.theme import MEASURED, MODELLED, SERIES
from groundstation.telemetry.packet import STANDARD_GRAVITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

CHANNELS = (
    *(f"gyro {axis} (deg/s)" for axis in "xyz"),
    *(f"accelerometer {axis} (g)" for axis in "xyz"),
    *(f"{axis} (deg)" for axis in ("roll", "pitch", "yaw")),
)
STRETCH_S = 3.0


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


def replay_page(title: str, runs: Sequence[Run], done: Sequence[Replayed], window_s: float) -> Page:
    """How far a model follows recordings, where it loses them first, and how fast."""
    page = Page(title, f"fresh start from the observed state every {window_s:g} s")
    errors = [errors_of(run, one) for run, one in zip(runs, done, strict=True)]
    every = np.vstack(errors)
    largest = np.nan_to_num(np.abs(every)).max(axis=0)
    page.table(
        ("channel", "RMS error", "largest"),
        [
            (name, float(a), float(b))
            for name, a, b in zip(CHANNELS, rms_of(every), largest, strict=True)
            if np.isfinite(a)
        ],
        "Measured less simulated, over the rows in the air.",
    )
    page.heading("Worst stretch")
    worst = max(range(len(runs)), key=lambda i: _tilt_error(errors[i]).max())
    run, one = runs[worst], done[worst]
    middle = int(np.argmax(_tilt_error(errors[worst])))
    half = round(0.5 * STRETCH_S / run.period_s)
    rows = slice(max(0, middle - half), min(len(run), middle + half))
    page.figure(overlay(run, one, rows), "Measured and simulated around the largest tilt error.")
    page.heading("Growth of the error")
    page.figure(
        _growth(runs, errors, window_s),
        "RMS error over the time since the last fresh start: noise makes a curve that starts at"
        " the sensor's own noise and grows slowly; missing physics makes it grow fast.",
    )
    return page


def reference_page(title: str, made: MadeRun) -> Page:
    """A flight along a reference: angles, rates, motors."""
    page = Page(title, "flown by a simple controller that knows the true state")
    error = np.degrees(made.reference - made.attitude)
    error = (error + 180.0) % 360.0 - 180.0
    page.table(
        ("axis", "RMS error deg", "largest deg"),
        [
            (axis, float(np.sqrt(np.mean(error[:, i] ** 2))), float(np.abs(error[:, i]).max()))
            for i, axis in enumerate(("roll", "pitch", "yaw"))
        ],
        "Reference less reported angle.",
    )
    time = np.arange(len(made.duty)) * made.period_s
    drawn, axes = figure(9.0, 8.0, rows=4, sharex=True)
    for i, axis in enumerate(("roll", "pitch", "yaw")):
        t, wanted, angle = thinned(
            time, np.degrees(made.reference[:, i]), np.degrees(made.attitude[:, i])
        )
        axes[i].plot(t, wanted, color=MEASURED, label="reference")
        axes[i].plot(t, angle, color=MODELLED, label="reported")
        axes[i].set_ylabel(f"{axis} (deg)")
    legend_above(axes[0])
    for i in range(4):
        t, speed = thinned(time, made.rotor_rev_s[:, i])
        axes[3].plot(t, speed, color=SERIES[i], label=f"M{i + 1}")
    axes[3].set_ylabel("rotors (rev/s)")
    axes[3].set_xlabel("time (s)")
    legend_above(axes[3])
    page.figure(drawn, "Angles against the reference, and rotor speeds.")
    return page


def _tilt_error(error: Array) -> Array:
    return np.asarray(np.nan_to_num(np.abs(error[:, 6:8]).max(axis=1)))


def overlay(run: Run, done: Replayed, rows: slice) -> Figure:
    """Measured and simulated, nine channels."""
    measured = channels_of(run.gyro, run.accelerometer, run.attitude)[rows]
    modelled = channels_of(done.gyro, done.accelerometer, done.attitude)[rows]
    time = run.time_s[rows] - run.recording_start_s
    drawn, axes = figure(9.5, 7.0, rows=3, columns=3, sharex=True)
    for i, name in enumerate(CHANNELS):
        t, one, other = thinned(time, measured[:, i], modelled[:, i])
        axes[i].plot(t, one, color=MEASURED, label="measured")
        axes[i].plot(t, other, color=MODELLED, label="simulated")
        axes[i].set_title(name)
    for axis in axes[6:]:
        axis.set_xlabel("time, s")
    drawn.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return drawn


def _growth(runs: Sequence[Run], errors: Sequence[Array], window_s: float) -> Figure:
    drawn, axes = figure(9.0, 3.0, columns=3)
    rows = max(1, round(window_s / runs[0].period_s))
    square, count = np.zeros((rows, 9)), np.zeros((rows, 9))
    for error in errors:
        whole = len(error) // rows
        pieces = error[: whole * rows].reshape(whole, rows, 9) ** 2
        square += np.nansum(pieces, axis=0)
        count += np.isfinite(pieces).sum(axis=0)
    rms = np.sqrt(square / np.maximum(count, 1))
    time = 1000.0 * runs[0].period_s * np.arange(rows)
    for i, label in enumerate(("gyro (deg/s)", "accelerometer (g)", "angle (deg)")):
        first = 3 * i
        for k in range(3):
            t, value = thinned(time[1:], rms[1:, first + k])
            axes[i].plot(t, value, color=SERIES[k], label=CHANNELS[first + k].split(" (")[0])
        axes[i].set_title(label)
        axes[i].set_xlabel("since fresh start (ms)")
        axes[i].legend(loc="upper left")  # errors grow: nothing lies there
    return drawn
