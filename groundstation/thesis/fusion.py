"""Figures 6.3 to 6.5: sensor fusion by hand, and the axes."""

from __future__ import annotations

from dataclasses import replace

from groundstation.attitude.fusion import angles_figure, axis_figure, check_axes, fuse
from groundstation.telemetry.arrays import AXES
from groundstation.thesis.entry import Entry, Made, Table
from groundstation.thesis.workshop import Workshop

METHODS = {
    "integrated": "gyro integrated (6.3-6.6)",
    "complementary": "complementary (6.7-6.10), W = 0.998",
    "kalman": "Kalman (6.11-6.21), offset at rest subtracted",
    "reported": "reported by the craft",
}


def _fusion(workshop: Workshop) -> Made:
    moved = workshop.said("fused.json")["end_minus_start_deg"]
    fused = fuse(workshop.samples("hand.csv"))
    return Made(
        "Turned by hand and put back, with a gyro that is 1.5, -1.2 and 0.8 deg/s off. Printed is"
        " that the angles match perfectly in the end. Only the ratio of Q and R matters, so that"
        " they are printed without units does not. Nothing ever corrects yaw: Kalman's stays only"
        " because the offset at rest was subtracted.",
        [
            Table(
                ["end minus start, deg", *AXES],
                [[words, *moved[name]] for name, words in METHODS.items()],
            )
        ],
        [
            angles_figure(fused, ("integrated", "reported")),
            angles_figure(fused, ("accelerometer", "complementary", "kalman", "reported")),
        ],
    )


def _inverted(workshop: Workshop) -> Made:
    samples = workshop.samples("axis.csv")
    sent = samples.attitude.copy()
    sent[:, 1] = -sent[:, 1]
    raw = replace(samples, attitude=sent)
    faults = [str(one) for one in check_axes(raw).faults]
    return Made(
        "The packet's pitch has the other sign than its gyro, as the thesis found. The decoder"
        " negates it; here that is undone. The axis check then says: "
        f"{', '.join(faults) or 'nothing'}.",
        [],
        [axis_figure(raw)],
    )


def _corrected(workshop: Workshop) -> Made:
    said = workshop.said("axes.json")
    return Made(
        f"As recordings have it, pitch nose down positive. Verdict: {said['verdict']}; what is"
        f" measured twice and does not agree: {', '.join(said['contradictions']) or 'nothing'}.",
        [],
        [axis_figure(workshop.samples("axis.csv"))],
    )


ENTRIES = (
    Entry("Figure 6.3", "Kalman fusion output", _fusion),
    Entry("Figure 6.4", "Crazyflie axis test no. 1", _inverted),
    Entry("Figure 6.5", "Crazyflie axis test no. 2", _corrected),
)
