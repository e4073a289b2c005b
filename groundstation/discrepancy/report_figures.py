"""Figures of the comparison and discrepancy reports."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.comparison.comparison import Comparison, Place, Spectrum, Stretch, over_time
from groundstation.comparison.gap import CHANNELS, HORIZONS_S, PER_SI, UNITS
from groundstation.dynamics.meanings import title_of
from groundstation.report.page import (
    GOOD,
    HEAT,
    IMPROVED,
    INK,
    MEASURED,
    MISSING,
    MODELLED,
    NEUTRAL,
    NOTE,
    ON_BRIGHT,
    ON_DARK,
    PAPER,
    figure,
    legend_above,
)
from groundstation.telemetry.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from groundstation.discrepancy.report_json import CandidateTried


LARGEST_RATIO = 10.0
"""Where the colours of a map end: what is beyond is wrong at a look anyway."""
WORTH_A_NUMBER = 1.1
MOST_BARS = 23


def titled(effect: str) -> str:
    """An effect as people call it; of one that may be of several rotors also which."""
    name, _, rotor = effect.partition(".")
    return title_of(name) + (f" ({rotor})" if rotor else "")


def label(channel: str) -> str:
    """A channel as people read it."""
    return channel.replace("_", " ")


def where_map(titled: Sequence[tuple[str, Sequence[Place]]]) -> Figure:
    """Channel by regime: prediction error over noise. One map, or before and after."""
    regimes = list(dict.fromkeys(p.regime for _, places in titled for p in _in_order(places)))
    made, axes = figure(9.6, 3.9 * len(titled) + 0.9, rows=len(titled), sharex=True)
    for axis, (title, places) in zip(axes, titled, strict=True):
        ratio = np.full((len(CHANNELS), len(regimes)), np.nan)
        for place in places:
            if place.expected_rms > 0 and place.regime in regimes:
                row, column = CHANNELS.index(place.channel), regimes.index(place.regime)
                ratio[row, column] = place.rms / place.expected_rms
        image = _heat(axis, ratio)
        for row, column in np.argwhere(np.isfinite(ratio)):
            value = ratio[row, column]
            if column > 0 and value < WORTH_A_NUMBER:
                continue
            dark = value < np.sqrt(LARGEST_RATIO)
            axis.text(
                column,
                row,
                f"{value:.2f}" if value < 9.995 else f"{value:.0f}",
                ha="center",
                va="center",
                fontsize=7.5,
                color=ON_DARK if dark else ON_BRIGHT,
            )
        axis.set_yticks(range(len(CHANNELS)), [label(c) for c in CHANNELS])
        axis.set_title(title)
        made.colorbar(image, ax=axis, pad=0.01, label="error over noise", ticks=TICKS, format="%g")
    axes[-1].set_xticks(range(len(regimes)), regimes, rotation=35, ha="right")
    return made


def time_map(comparison: Comparison, number: int = 0) -> Figure:
    """Channel by second of one run: prediction error over noise."""
    errors, floor = comparison.errors[number], comparison.floors[number]
    time, ratio = over_time(errors, floor)
    made, (axis,) = figure(9.6, 2.9)
    time = time - errors.run.recording_start_s
    edges = (time[0] - 0.5, time[-1] + 0.5, len(CHANNELS) - 0.5, -0.5)
    image = _heat(axis, ratio.T, extent=edges)
    axis.set_yticks(range(len(CHANNELS)), [label(c) for c in CHANNELS])
    axis.set_xlabel(f"time in {errors.run.name}, s")
    made.colorbar(image, ax=axis, pad=0.01, label="error over noise", ticks=TICKS, format="%g")
    return made


def by_horizon(before: Comparison, after: Comparison | None = None) -> Figure:
    """Each channel's error over noise at 20 and at 50 ms, before and after."""
    shown = [k for k in range(9) if np.isfinite(before.noise_floor[k])]
    made, axes = figure(9.6, 2.9, columns=2, sharey=True)
    for number, (axis, horizon) in enumerate(zip(axes, HORIZONS_S, strict=True)):
        floor = before.at_horizon(number)[1]
        first = (before.at_horizon(number)[0] / floor)[shown]
        place = np.arange(len(shown))
        if after is None:
            axis.hlines(place, 1.0, first, color=NEUTRAL, linewidth=1.0, zorder=0.5)
        else:
            second = (after.at_horizon(number)[0] / floor)[shown]
            axis.hlines(place, second, first, color=NEUTRAL, linewidth=1.0, zorder=0.5)
            axis.plot(second, place, "o", color=IMPROVED, label="improved model")
        axis.plot(first, place, "o", color=MODELLED, label="model", zorder=1.9)
        axis.axvline(1.0, color=MEASURED, linewidth=1.0, linestyle="--", label="noise")
        axis.set_xscale("log")
        _plain_ticks(axis.xaxis, max(2.0, float(np.nanmax(first))))
        axis.set_yticks(place, [label(CHANNELS[k]) for k in shown])
        axis.set_title(f"{horizon * 1e3:.0f} ms ahead")
        axis.set_xlabel("error over noise")
    axes[0].invert_yaxis()
    made.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False
    )
    return made


def worst_overlay(stretch: Stretch, before: Comparison, after: Comparison | None = None) -> Figure:
    """Measured, and predicted 50 ms ahead, where one channel is predicted worst."""
    channel = CHANNELS.index(stretch.channel)
    unit = PER_SI[channel]
    rows = slice(stretch.first, stretch.last)
    errors = before.errors[stretch.run]
    run = errors.run
    time = run.time_s[rows] - run.recording_start_s
    measured = np.hstack([run.gyro, run.accelerometer, run.attitude])[rows, channel] * unit
    made, axes = figure(9.6, 4.4, rows=2, sharex=True, height_ratios=[3, 2])
    axes[0].plot(time, measured, color=MEASURED, label="measured")
    shown = [("model", MODELLED, before)]
    if after is not None:
        shown.append(("improved model", IMPROVED, after))
    for name, color, one in shown:
        error = one.errors[stretch.run].horizons[-1][rows, channel] * unit
        known = np.isfinite(error)
        part = (time[known], (measured - error)[known])
        if channel in (3, 4, 5):
            axes[0].plot(*part, ".", markersize=1.6, color=color, label=f"{name}, 50 ms ahead")
        else:
            axes[0].plot(*part, color=color, linewidth=1.0, label=f"{name}, 50 ms ahead")
        axes[1].plot(time[known], error[known], color=color, linewidth=1.0)
    noise = before.at_horizon(len(HORIZONS_S) - 1)[1][channel] * unit
    axes[1].axhspan(-2 * noise, 2 * noise, color=NEUTRAL, alpha=0.2, linewidth=0)
    axes[0].set_ylabel(f"{label(stretch.channel)}, {UNITS[stretch.channel]}")
    axes[0].set_title(f"{label(stretch.channel)} in {run.name}", loc="left")
    legend_above(axes[0])
    axes[1].set_ylabel(f"error, {UNITS[stretch.channel]}")
    axes[1].set_xlabel("time, s")
    return made


def residual_spectrum(before: Spectrum, after: Spectrum | None = None) -> Figure:
    """Power density of one-row-ahead errors, before, after, and what noise leaves."""
    made, (axis,) = figure(9.6, 3.2)
    lines = [("model", MODELLED, before.error)]
    if after is not None:
        lines.append(("improved model", IMPROVED, after.error))
    lines.append(("noise", MEASURED, before.expected))
    for name, color, power in lines:
        style: dict[str, Any] = {"linestyle": "--"} if name == "noise" else {}
        axis.loglog(before.frequency_hz[1:-1], power[1:-1], color=color, label=name, **style)
    axis.set_xlabel("frequency, Hz")
    axis.set_ylabel(f"({UNITS[before.channel]})²/Hz")
    axis.set_title(f"{label(before.channel)}: errors one row ahead", loc="left")
    legend_above(axis)
    return made


def evidence_bars(candidates: Sequence[CandidateTried]) -> Figure:
    """How strongly the recordings speak for each effect before any was added."""
    shown = sorted(candidates, key=lambda c: c.score, reverse=True)[:MOST_BARS]
    made, (axis,) = figure(9.6, 0.9 + 0.24 * max(len(shown), 3))
    place = np.arange(len(shown))
    score = np.array([max(c.score, 0.1) for c in shown])
    colors = [GOOD if c.accepted else NEUTRAL for c in shown]
    axis.barh(place, score, color=colors, height=0.7, left=0.1)
    axis.set_xscale("log")
    axis.set_yticks(place, [titled(c.name) for c in shown])
    notes = {
        one.name: shorten(one.reason or "accepted", NOTE_MOST, placeholder=" …") for one in shown
    }
    for y, one, size in zip(place, shown, score, strict=True):
        note = notes[one.name]
        axis.annotate(
            note,
            (size + 0.1, float(y)),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=7.5,
            color=INK if one.accepted else NOTE,
            weight="bold" if one.accepted else "normal",
        )
    # As many decades as leave room for every note.
    room = [0.98 - NOTE_CHARACTER * len(notes[one.name]) for one in shown]
    decades = np.log10(score / 0.1 + 1.0) / np.maximum(room, 0.2)
    axis.set_xlim(0.1, 0.1 * 10 ** max(3.0, float(decades.max(initial=3.0))))
    axis.invert_yaxis()
    axis.grid(visible=False, axis="y")
    axis.set_xlabel("evidence by itself: drop of -2 log likelihood")
    return made


def waterfall(steps: Sequence[tuple[str, float]]) -> Figure:
    """The gap on proof samples, from the given model to the improved one, effect by effect."""
    made, (axis,) = figure(9.6, 1.1 + 0.36 * (len(steps) + 1))
    values = np.array([gap for _, gap in steps])
    place = np.arange(len(steps))
    axis.barh(0, values[0], color=MODELLED, height=0.6)
    for k in range(1, len(steps)):
        low, high = sorted((values[k - 1], values[k]))
        axis.barh(
            k,
            high - low,
            left=low,
            color=GOOD if values[k] <= values[k - 1] else MODELLED,
            height=0.6,
        )
        axis.vlines(values[k - 1], k - 1.3, k + 0.3, color=NEUTRAL, linewidth=0.8)
    last = len(steps)
    axis.barh(last, values[-1], color=IMPROVED, height=0.6)
    for k, value in enumerate([*values, values[-1]]):
        step = 0 < k < last
        words = f"{values[k - 1]:.2f} → {value:.2f}" if step else f"{value:.2f}"
        axis.annotate(
            words,
            (max(value, values[k - 1]) if step else value, k),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 1.0},
        )
    names = [titled(name) for name, _ in steps]
    axis.set_yticks([*place, last], [names[0], *(f"+ {n}" for n in names[1:]), "improved model"])
    axis.axvline(1.0, color=MEASURED, linestyle="--", linewidth=1.0)
    axis.annotate("noise", (1.0, -0.6), xytext=(3, 0), textcoords="offset points", fontsize=8.5)
    axis.set_xlim(0.0, float(values.max()) * 1.2)
    axis.set_ylim(last + 0.6, -0.9)
    axis.grid(visible=False, axis="y")
    axis.set_xlabel("gap over all channels, proof samples (1: nothing left to explain)")
    return made


NOTE_MOST = 70
"""Characters of a note beside a bar; the table has all of it."""
NOTE_CHARACTER = 0.0068
"""Width of a character of a note beside a bar, as a share of the axes."""
TICKS = (1.0, 1.5, 2.0, 3.0, 5.0, 10.0)


def _heat(axis: Any, ratio: Array, **more: Any) -> Any:
    from matplotlib.colors import LogNorm

    image = axis.imshow(
        np.clip(ratio, 1.0, None),
        aspect="auto",
        cmap=HEAT,
        norm=LogNorm(1.0, LARGEST_RATIO),
        interpolation="nearest",
        **more,
    )
    axis.grid(visible=False)
    axis.set_facecolor(MISSING)
    return image


def _plain_ticks(axis: Any, most: float) -> None:
    """Round numbers on a logarithmic axis, written out."""
    from matplotlib.ticker import FixedLocator, FormatStrFormatter, NullLocator

    ticks = [1.0, 1.1, 1.2, 1.4] if most < 1.7 else [1.0, 1.5] if most < 8 else [1.0]
    ticks += [base * 10.0**power for power in range(4) for base in (2, 5, 10)]
    axis.set_major_locator(FixedLocator([tick for tick in ticks if tick <= 1.5 * most]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FormatStrFormatter("%g"))


def _in_order(places: Sequence[Place]) -> list[Place]:
    """The whole flight first, then regimes from the worst on."""
    return sorted(places, key=lambda place: place.regime != "whole flight")
