"""Channels over time: lines, single readings, one channel against another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from groundstation.report.figure import figure, legend_above, thinned
from groundstation.report.theme import MEASURED, MODELLED, SERIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

HEIGHT = 2.7


def lines(time_s: NDArray[Any], channels: Mapping[str, NDArray[Any]], label: str) -> Figure:
    """Channels (n,) by name over time, in one panel."""
    made, (axes,) = figure(height=HEIGHT)
    for color, (name, values) in zip(SERIES, channels.items(), strict=False):
        axes.plot(*thinned(time_s, values), color=color, label=name)
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    if len(channels) > 1:
        legend_above(axes)
    return made


def points(time_s: NDArray[Any], channels: Mapping[str, NDArray[Any]], label: str) -> Figure:
    """Readings (n,) that come singly, by name."""
    made, (axes,) = figure(height=HEIGHT)
    for color, (name, values) in zip((MEASURED, MODELLED), channels.items(), strict=False):
        shown = thinned(time_s, values)
        axes.plot(*shown, ".", color=color, markersize=2.5, label=name)
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    if len(channels) > 1:
        legend_above(axes, markerscale=4)
    return made


def against(
    time_s: NDArray[Any], values: NDArray[Any], label: str, other: NDArray[Any], other_label: str
) -> Figure:
    """A channel (n,) and, dashed on a scale of its own, what drives it."""
    made, (axes,) = figure(height=HEIGHT)
    axes.plot(*thinned(time_s, values), color=MEASURED)
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    beside = axes.twinx()
    beside.plot(*thinned(time_s, other), "--", color=MODELLED, linewidth=0.9)
    beside.set_ylabel(other_label, color=MODELLED)
    beside.grid(visible=False)
    return made
