"""Figures of the demo's report, from the files that its stages left."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.comparison.channels import CHANNELS
from groundstation.comparison.gap import UNITS
from groundstation.control.step_analysis import Flown
from groundstation.control.step_recording import analyse_recording
from groundstation.demo.outcome import Distance, channels, flight, flights_apart, watched
from groundstation.discrepancy.report_figures import label
from groundstation.discrepancy.report_json import DiscrepancyReport
from groundstation.dynamics.model import load_model
from groundstation.identification.division import hold_out
from groundstation.identification.fit_record import liveliest
from groundstation.identification.motor.fit import bench_run, simulate_run
from groundstation.recording.open_recording import open_recording
from groundstation.report.figure import figure, legend_above
from groundstation.report.theme import BAD, FAINT, IMPROVED, MEASURED, MODELLED, NEUTRAL, SERIES
from groundstation.twin.twin import Twin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN_S = 4.0
GAP_TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0)
SMOOTH_S = 0.04
"""Accelerations are averaged over this to be drawn: their noise would hide what differs."""
COLOURED = 3
"""Channels that stand out in the twin's picture."""
RATES = (("gyro_x", "roll rate"), ("gyro_y", "pitch rate"), ("gyro_z", "yaw rate"))


def motor_figure(folder: Path) -> Figure:
    """Rotor speed on the bench, and the fitted motor's answer to the same voltage."""
    model = load_model(str(folder / "motor.json"))
    account = model.fit["motor"]["estimates"]
    delay_s = account["values"][account["names"].index("delay_s")]
    _, held = hold_out([flight(folder / "bench.csv")])
    run = bench_run(held[0])
    modelled = simulate_run(run, model.motor, delay_s)
    rows = liveliest(run.voltage_mv, run.period_s, SHOWN_S)
    fresh = np.flatnonzero(np.isfinite(run.rev_s[rows])) + rows.start
    time = fresh * run.period_s
    made, (speed, voltage) = figure(9.6, 4.0, rows=2, sharex=True, height_ratios=[3, 1])
    speed.plot(time, run.rev_s[fresh], "o", markersize=3.2, color=NEUTRAL, label="measured")
    speed.plot(time, modelled[fresh], color=IMPROVED, label="fitted motor, from the voltage alone")
    speed.set_ylabel("rotor speed, rev/s")
    _headroom(speed)
    voltage.plot(run.period_s * np.arange(rows.start, rows.stop), run.voltage_mv[rows] / 1000.0,
                 color=MEASURED)  # fmt: skip
    voltage.set_ylabel("motor, V")
    voltage.set_xlabel("time on the bench, held-out part, s")
    return made


def body_figure(folder: Path) -> Figure:
    """Measured rates, and the fitted craft's on the same motor commands."""
    run = flight(folder / "flight2.csv")
    table = np.genfromtxt(folder / "simulated.csv", delimiter=",", names=True)
    measured = channels(run)
    rows = liveliest(measured[:, 0] + measured[:, 2], run.period_s, SHOWN_S)
    time = table["time_s"][rows] - run.time_s[0]
    made, axes = figure(9.6, 5.4, rows=3, sharex=True)
    for axis, (channel, name) in zip(axes, RATES, strict=True):
        axis.plot(time, measured[rows, CHANNELS.index(channel)], color=MEASURED, label="measured")
        modelled = table[f"{channel}_dps"][rows]
        axis.plot(time, modelled, color=IMPROVED, label="fitted model, from the motors' PWM")
        axis.set_ylabel(f"{name}\ndeg/s")
    _headroom(axes[0])
    axes[-1].set_xlabel("time in the flight, s")
    return made


def flown_steps(folder: Path, report: dict[str, Any]) -> Flown:
    """The steps of the controller's flight, measured and predicted. report: of ``pid fly``."""
    recording = open_recording(Path(report["recording"]))
    model = load_model(str(folder / "body.json"))
    return analyse_recording(recording, model, report["gains"], "pid fly")


def twin_figure(folder: Path, noticed: list[dict[str, Any]]) -> Figure:
    """The watched flight: gap by channel over time, and what the twin said when."""
    recording = open_recording(watched(folder))
    samples = recording.samples
    twin = Twin(load_model(str(folder / "body.json")))
    shown = [one for one, _ in twin.feed(samples) if len(one.time_s)]
    time = np.array([one.time_s[-1] for one in shown])
    gap = np.array([one.gap for one in shown])
    made, (axis,) = figure(9.6, 3.8)
    if not np.isfinite(gap).any():
        axis.text(0.5, 0.5, "the twin never came to judge: it learns the noise first, in the air",
                  ha="center", transform=axis.transAxes)  # fmt: skip
        axis.set_axis_off()
        return made
    worst = np.argsort(-np.max(np.nan_to_num(gap), axis=0))
    for channel in worst[::-1]:
        told = int(np.flatnonzero(worst == channel)[0])
        color = SERIES[told] if told < COLOURED else FAINT
        axis.plot(time, gap[:, channel], color=color, linewidth=1.8 if told < COLOURED else 1.0,
                  label=label(CHANNELS[channel]) if told < COLOURED else None)  # fmt: skip
    axis.axhline(1.0, color=MEASURED, linestyle="--", linewidth=1.0, label="noise alone")
    axis.set_yscale("log")
    highest = 2.2 * max(3.0, float(np.nanmax(gap)))
    lowest = 0.7 * min(0.6, float(np.nanmin(gap)))
    axis.set_yticks([tick for tick in GAP_TICKS if lowest < tick < highest])
    axis.set_yticks([], minor=True)
    axis.yaxis.set_major_formatter("{x:g}")
    axis.set_ylim(lowest, highest)
    axis.set_xlim(float(samples.time_s[0]), float(samples.time_s[-1]))
    if noticed:
        heard_s = float(noticed[0]["details"]["noticed_s"])
        axis.axvline(heard_s, color=BAD, linewidth=1.6)
        axis.annotate(
            " the twin is sure", (heard_s, 1.1 * lowest), color=BAD, fontsize=9, va="bottom"
        )
    axis.set_ylabel("prediction error over noise")
    axis.set_xlabel("device time, s")
    legend_above(axis)
    return made


def gap_steps(found: DiscrepancyReport) -> list[tuple[str, float]]:
    """The gap of the given model, and after each effect that joined."""
    steps = [("model", found.gap.validation.before)]
    return steps + [(effect.name, effect.gap.after) for effect in found.effects]


def beside_figure(folder: Path, distance: Distance) -> Figure:
    """The channel in which the first model strays most: all three flights of one seed."""
    worst = int(np.argmax(distance.old / distance.moved))
    time, *three = flights_apart(folder)
    true, old, new = (one[:, worst] for one in three)
    period_s = float(time[1] - time[0])
    if UNITS[CHANNELS[worst]] == "g":
        mean = np.full(round(SMOOTH_S / period_s), period_s / SMOOTH_S)
        true, old, new = (np.convolve(one, mean, "same") for one in (true, old, new))
    rows = liveliest(np.cumsum(np.abs(old - true)) * period_s, period_s, SHOWN_S)
    made, (above, below) = figure(9.6, 4.4, rows=2, sharex=True, height_ratios=[3, 2])
    above.plot(time[rows], true[rows], color=MEASURED, linewidth=2.4, label="hidden craft")
    above.plot(time[rows], old[rows], color=MODELLED, label="first model flies")
    above.plot(time[rows], new[rows], color=IMPROVED, label="improved model flies")
    channel = CHANNELS[worst]
    above.set_ylabel(f"{label(channel)}, {UNITS[channel]}")
    _headroom(above)
    below.plot(time[rows], (old - true)[rows], color=MODELLED)
    below.plot(time[rows], (new - true)[rows], color=IMPROVED)
    below.set_ylabel(f"difference, {UNITS[channel]}")
    below.set_xlabel("time in the flight, s")
    return made


def distance_figure(distance: Distance) -> Figure:
    """How far each channel strays, as a share of how much it moves."""
    place = np.arange(len(CHANNELS))
    made, (axis,) = figure(9.6, 3.2)
    for shift, values, color, name in (
        (-0.2, distance.old, MODELLED, "first model"),
        (0.2, distance.new, IMPROVED, "improved model"),
    ):
        share = 100 * values / distance.moved
        axis.barh(place + shift, share, 0.38, color=color, label=name)
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.set_yticks(place, [label(channel) for channel in CHANNELS])
    axis.invert_yaxis()
    axis.grid(visible=False, axis="y")
    axis.set_xlabel("RMS difference from the hidden craft's flight, % of the channel's movement")
    made.legend(*axis.get_legend_handles_labels(), loc="outside upper right", ncols=2,
                frameon=False)  # fmt: skip
    return made


def _headroom(axis: Axes) -> None:
    """Room above the lines for a legend in one row."""
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.25 * (high - low))
    legend_above(axis)
