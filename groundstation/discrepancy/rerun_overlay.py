"""Measured beside predicted, before and after, as columns for the viewer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.comparison.comparison import over_time
from groundstation.comparison.gap import CHANNELS, HORIZONS_S, PER_SI, UNITS
from groundstation.discrepancy.proof import Proof
from groundstation.discrepancy.report_json import DiscrepancyReport
from groundstation.telemetry.arrays import Array

PAUSE_S = 2.0
"""Between flights that follow each other on one time axis."""
SERIES = ("measured", "model", "improved model")


@dataclass(frozen=True, slots=True)
class Overlay:
    """What the viewer shows.

    time_s: (n,). channels: name -> (unit, (n, 3) measured, given model and improved model 50 ms
    ahead; NaN where there is no prediction). gap_time_s: (m,), gap: (m, 2) error over noise of all
    channels, before and after. flights: (time in s, name). text: the findings, Markdown.
    """

    time_s: Array
    channels: dict[str, tuple[str, Array]]
    gap_time_s: Array
    gap: Array
    flights: tuple[tuple[float, str], ...]
    text: str


def overlay_of(proof: Proof, report: DiscrepancyReport) -> Overlay:
    """The proof flights one after the other."""
    times, values, gap_times, gaps, flights = [], [], [], [], []
    begin = 0.0
    for number, before in enumerate(proof.before.errors):
        after = proof.after.errors[number]
        run = before.run
        offset = begin - float(run.time_s[0])
        times.append(run.time_s + offset)
        measured = np.hstack([run.gyro, run.accelerometer, run.attitude])
        predicted = [measured - one.horizons[-1] for one in (before, after)]
        values.append(np.stack([measured, *predicted], axis=2) * PER_SI[:, None])
        seconds, first = over_time(before, proof.before.floors[number])
        _, second = over_time(after, proof.before.floors[number])
        gap_times.append(seconds + offset)
        gaps.append(np.column_stack([_all(first), _all(second)]))
        flights.append((begin, run.name))
        begin += run.seconds + PAUSE_S
    stacked = np.vstack(values)
    return Overlay(
        np.concatenate(times),
        {name: (UNITS[name], stacked[:, k]) for k, name in enumerate(CHANNELS)},
        np.concatenate(gap_times),
        np.vstack(gaps),
        tuple(flights),
        _text(report),
    )


def _all(ratio: Array) -> Array:
    """Root mean square over the channels (m, 9) that are known; NaN where none is."""
    known = np.isfinite(ratio)
    count = known.sum(axis=1)
    total = np.where(known, ratio, 0.0) ** 2
    mean = np.divide(total.sum(axis=1), count, out=np.full(len(ratio), np.nan), where=count > 0)
    return np.sqrt(mean)


def _text(report: DiscrepancyReport) -> str:
    level = report.gap.validation
    lines = [
        f"# {report.verdict.replace('_', ' ')}",
        f"Gap on proof samples **{level.before:.2f}** before, **{level.after:.2f}** after;"
        " 1 is noise.",
        "",
    ]
    for effect in report.effects:
        values = ", ".join(
            f"{name} = {one.value:.4g} {one.unit}".strip()
            for name, one in effect.parameters.items()
        )
        lines += [f"{effect.order}. **{effect.name}** ({values}): {effect.adds}"]
    lines += [
        "",
        f"Plots: measured, and predicted {HORIZONS_S[-1] * 1e3:.0f} ms ahead by {report.model} and"
        " by the improved model (white, orange, blue) around the cursor: click into the gap plot"
        " where it is high. The gap is over all channels, second by second.",
    ]
    return "\n".join(lines)
