"""Fits and replayed flights as the Python API shows them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.identification.advice import good_for
from groundstation.identification.fit_record import Identified
from groundstation.identification.replayed import CHANNELS, Replayed, channels_of
from groundstation.identification.report import certainty, residual, steps, trace
from groundstation.report.page import MEASURED, MODELLED, Shown, figure, thinned

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

SHOWN_S = 5.0


def identified(one: Identified) -> Shown:
    """The estimates with their errors; each figure of the report."""
    columns: dict[str, list[object]] = {
        name: [] for name in ("part", "name", "value", "stderr", "low", "high")
    }
    pictures: dict[str, Callable[[], Figure]] = {}
    for part, estimates in one.evidence.estimates.items():
        interval = estimates.interval()
        for k, name in enumerate(estimates.names):
            row = (part, name, estimates.values[k], estimates.stderr[k], *interval[k])
            for column, cell in zip(columns.values(), row, strict=True):
                column.append(cell if isinstance(cell, str) else float(cell))
        if len(estimates.names) > 1:
            several = len(one.evidence.estimates) > 1
            name = f"certainty {part}" if several else "certainty"
            pictures[name] = partial(certainty, estimates)
    pictures |= {each.channel: partial(trace, each) for each in one.evidence.traces}
    for each in one.evidence.residuals:
        pictures[f"residuals of {each.channel}"] = partial(residual, each)
    if one.evidence.steps:
        pictures["step responses"] = partial(steps, one.evidence.steps)
    return Shown(f"{one}: {good_for(one.model, one.account)[0]}", columns, one.warnings, pictures)


def replayed(one: Replayed) -> Shown:
    """Every sample of each channel; measured and simulated where they move most."""
    run = one.run
    columns: dict[str, Any] = {"time_s": run.time_s - run.recording_start_s}
    for name in ("gyro", "accelerometer", "attitude"):
        for axis in range(3):
            columns[f"{name}_{'xyz'[axis]}"] = getattr(one, name)[:, axis]
    columns["flown"] = one.flown
    first = int(np.argmax(one.flown))
    rows = slice(first, first + round(SHOWN_S / run.period_s))
    return Shown(repr(one), columns, (), {"channels": partial(_overlay, one, rows)})


def _overlay(done: Replayed, rows: slice) -> Figure:
    """Measured and simulated, nine channels."""
    run = done.run
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
