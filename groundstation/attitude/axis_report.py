"""A page on an axis check: the three turns as each source shows them (thesis Figures 6.4, 6.5)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundstation.attitude.axis_check import AxisCheck
from groundstation.attitude.sensors import accelerometer_attitude, integrate_gyroscope
from groundstation.report.figure import figure, legend_above, thinned
from groundstation.report.page import Page
from groundstation.report.theme import MEASURED, SERIES
from groundstation.telemetry.arrays import AXES
from groundstation.telemetry.samples import SampleBatch

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def axis_page(samples: SampleBatch, check: AxisCheck, apart: list[str], name: str) -> Page:
    """apart: what is measured twice and does not agree, in lines. name: of the recording."""
    page = Page(f"Axes of {name}", f"{len(samples)} rows")
    kind = {"as_expected": "good", "wrong_axes": "bad"}.get(check.verdict, "neutral")
    page.verdict(check.verdict.replace("_", " ").capitalize() + ".", kind)
    page.bullets([str(one) for one in check.findings] + list(check.unclear) + apart)
    page.heading("The turns")
    page.figure(
        axis_figure(samples),
        "Left up, nose down, counter-clockwise, each there and back, must show first upwards and on"
        " its own panel, whatever shows it.",
    )
    return page


def axis_figure(samples: SampleBatch) -> Figure:
    """Each axis by the gyro's integral, by gravity, and as reported, in deg."""
    time = samples.time_s - samples.time_s[0]
    tilt = accelerometer_attitude(samples.accelerometer)
    shown = {
        "gyro, integrated": integrate_gyroscope(samples.time_s, samples.gyro),
        "accelerometer": np.column_stack([tilt, np.full(len(tilt), np.nan)]),
        "reported": np.unwrap(samples.attitude.astype(np.float64), axis=0),
    }
    made, every = figure(height=5.0, rows=3, sharex=True)
    for axis, (axes, name) in enumerate(zip(every, AXES, strict=True)):
        for color, (source, angles) in zip((*SERIES[:2], MEASURED), shown.items(), strict=True):
            angle = np.degrees(angles[:, axis] - angles[:50, axis].mean())
            if np.isfinite(angle).any():
                style = "--" if source == "reported" else "-"
                axes.plot(*thinned(time, angle), style, color=color, label=source)
        axes.set_ylabel(f"{name}, deg")
    legend_above(every[0])
    every[-1].set_xlabel("time, s")
    return made
