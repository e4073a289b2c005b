"""Figures that several entries share: models beside what was measured, correlations, steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from groundstation.report.page import (
    BAD,
    GOOD,
    MEASURED,
    MODELLED,
    NEUTRAL,
    SERIES,
    figure,
    thinned,
)
from groundstation.telemetry.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from groundstation.identification.estimate import CorrelationTest

LOST = (-3.0, 5.0)
"""A response over its step that leaves these bounds is not drawn further."""


def overlay(
    time_s: Array, measured: Array, modelled: Array, label: str, note: str = "modelled"
) -> Figure:
    """A measured channel and what a model makes of it."""
    made, (axes,) = figure(height=2.7)
    axes.plot(*thinned(time_s, measured), color=MEASURED, label="measured")
    axes.plot(*thinned(time_s, modelled), color=MODELLED, label=note)
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    axes.legend(loc="best", ncols=2)
    return made


def correlation(test: CorrelationTest, label: str) -> Figure:
    """Correlation by lag with its bounds, what lies outside in another colour."""
    made, (axes,) = figure(height=2.4)
    axes.axhspan(-test.bound, test.bound, color=NEUTRAL, alpha=0.25, linewidth=0)
    outside = np.abs(test.values) > test.bound
    for mask, color in ((~outside, GOOD), (outside, BAD)):
        axes.vlines(test.lags[mask], 0, test.values[mask], color=color, linewidth=2.2)
    axes.axhline(0, color=MEASURED, linewidth=0.7)
    axes.set_xlabel("input so many rows earlier")
    axes.set_ylabel(label)
    return made


def both_steps(time_s: Array, output: Array, label: str) -> Figure:
    """The answer to a lasting unit of u', one way and the other."""
    made, (axes,) = figure(height=2.4)
    axes.plot(time_s, output, color=SERIES[0], label="+1")
    axes.plot(time_s, -output, color=SERIES[1], label="-1")
    axes.axhline(0, color=NEUTRAL, linewidth=0.7)
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    axes.legend(loc="best")
    return made


def responses(panels: Mapping[str, Sequence[tuple[str, Array]]], period_s: float) -> Figure:
    """Step responses, one panel an axis, several lines in each; what diverges ends where it leaves
    the panel for good."""
    made, every = figure(height=2.8, columns=len(panels), sharey=True)
    for axes, (title, here) in zip(every, panels.items(), strict=True):
        for color, (label, y) in zip(SERIES, here, strict=False):
            lost = np.flatnonzero((y < LOST[0]) | (y > LOST[1]))
            shown = np.clip(y[: lost[0] + 1] if len(lost) else y, *LOST)
            axes.plot(period_s * np.arange(len(shown)), shown, color=color, label=label)
        axes.axhline(1.0, color=NEUTRAL, linewidth=0.8)
        axes.set_title(title)
        axes.set_xlim(0.0, period_s * max(len(y) for _, y in here))
        axes.set_ylim(-0.5, 2.5)
        axes.set_xlabel("s")
        axes.legend(loc="lower right")
    every[0].set_ylabel("response / step")
    return made
