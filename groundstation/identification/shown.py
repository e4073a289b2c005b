"""Fits and replayed flights as the Python API shows them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.identification.advice import good_for
from groundstation.identification.fit_record import Identified
from groundstation.identification.replayed import Replayed
from groundstation.identification.replayed_report import overlay
from groundstation.identification.report import certainty, residual, steps, trace
from groundstation.report.result import Shown

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
            pictures[name] = partial(certainty, estimates, {})
    pictures |= {each.channel: partial(trace, each) for each in one.evidence.traces}
    for each in one.evidence.residuals:
        pictures[f"residuals of {each.channel}"] = partial(residual, each)
    if one.evidence.steps:
        pictures["step responses"] = partial(steps, one.evidence.steps)
    return Shown(f"{one}: {good_for(one.account)[0]}", columns, one.warnings, pictures)


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
    return Shown(repr(one), columns, (), {"channels": partial(overlay, run, one, rows)})
