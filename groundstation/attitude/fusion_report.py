"""A page on sensor fusion: drift, filters, and what the craft reports (thesis Figures 6.3, 6.5)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundstation.attitude.fusion import Fused
from groundstation.report.figure import figure, legend_above, thinned
from groundstation.report.page import Page
from groundstation.report.theme import MEASURED, SERIES
from groundstation.telemetry.arrays import AXES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = dict(
    zip(("integrated", "complementary", "kalman", "accelerometer"), SERIES, strict=False)
) | {"reported": MEASURED}
FILTERS = ("complementary", "kalman")


def fusion_page(fused: Fused, name: str) -> Page:
    """name: of the recording."""
    noise = fused.noise
    page = Page(
        f"Attitude of {name}",
        f"{len(fused.time_s)} rows; W = {fused.weight:g}; Q = ({noise.angle:.3g} deg^2,"
        f" {noise.bias:.3g} (deg/s)^2), R = {noise.accelerometer:.3g} deg^2",
    )
    at_rest = (
        "the recording does not begin at rest, so nothing was subtracted from the gyro"
        if fused.rest_bias is None
        else "at rest the gyro reads "
        + ", ".join(f"{value:.2f}" for value in np.degrees(fused.rest_bias))
        + " deg/s, which was subtracted from the Kalman filter's input"
    )
    page.text(
        "Turned by hand and put back, each angle should end where it began. Integration drifts with"
        f" the gyro's offset; {at_rest}. Yaw has no reference on any of these ways. In flight the"
        " accelerometer feels thrust instead of gravity: its angles then say nothing."
    )
    page.table(
        ["end minus start, deg", *AXES],
        [
            [method, *(None if np.isnan(value) else value for value in values)]
            for method, values in fused.moved_deg().items()
        ],
    )
    page.heading("Drift")
    page.figure(
        angles_figure(fused, ("integrated", "reported")),
        "The gyro integrated from the first row on, beside the reported angles.",
    )
    page.heading("Filters")
    page.figure(
        angles_figure(fused, ("accelerometer", *FILTERS, "reported")),
        "The accelerometer's angle, what the two filters make of it and of the gyro, and what the"
        " craft reports.",
    )
    page.heading("Filters less reported")
    page.figure(_differences(fused), "The same two filters, less the reported angle.")
    return page


def angles_figure(fused: Fused, methods: tuple[str, ...]) -> Figure:
    """Angles by method in deg, one panel an axis."""
    made, every = figure(height=6.0, rows=3, sharex=True)
    for i, (axes, name) in enumerate(zip(every, AXES, strict=True)):
        for method in methods:
            angle = np.degrees(fused.angles[method][:, i])
            if np.isfinite(angle).any():
                faint = method == "accelerometer"
                axes.plot(
                    *thinned(fused.time_s, angle),
                    color=COLOURS[method],
                    linewidth=0.5 if faint else 1.3,
                    alpha=0.5 if faint else 1.0,
                    linestyle="--" if method == "reported" else "-",
                    label=method,
                )
        axes.set_ylabel(f"{name}, deg")
    legend_above(every[0])
    every[-1].set_xlabel("time, s")
    return made


def _differences(fused: Fused) -> Figure:
    made, every = figure(height=5.0, rows=3, sharex=True)
    for i, (axes, name) in enumerate(zip(every, AXES, strict=True)):
        for method in FILTERS:
            left = fused.angles[method][:, i] - fused.angles["reported"][:, i]
            axes.plot(*thinned(fused.time_s, np.degrees(left)), color=COLOURS[method], label=method)
        axes.set_ylabel(f"{name}, deg")
    legend_above(every[0])
    every[-1].set_xlabel("time, s")
    return made
