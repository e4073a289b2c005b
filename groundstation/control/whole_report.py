"""What a design for the whole loop reports, and a joystick flown on it: numbers and pages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.control.design import Limits
from groundstation.control.design_report import (
    DESIGN_HEAD,
    DIRECT,
    GAINS_HEAD,
    axis_entry,
    design_row,
    gain_rows,
    limits_line,
    outcome,
)
from groundstation.control.evaluate import WHOLE_STEP_RAD, evaluate
from groundstation.control.joystick import Followed
from groundstation.control.loop_figures import add_loop_figures
from groundstation.control.pid import AXES
from groundstation.control.report import BROKEN_AT, LOOP_NAMES, front_figure, step_figure
from groundstation.control.thesis_loop import counts_per_control
from groundstation.control.whole_design import AT_STOPS_S, STEPS_RAD, WINDOW_S, WholeDesign
from groundstation.dynamics.mixer import PWM_FULL
from groundstation.dynamics.model import Model
from groundstation.report.figure import MOST_POINTS, figure
from groundstation.report.page import Page
from groundstation.report.theme import IMPROVED, MEASURED, MODELLED, SERIES
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PURPOSES = (
    ("kp", "sets how fast the angle follows"),
    ("ki", "removes trim and what the model leans"),
    ("kd", "damps against the motors' lag"),
)


def whole_report(model: Model, designs: Sequence[WholeDesign], limits: Limits) -> dict[str, Any]:
    """``pid design --loop whole --json``."""
    axes = {}
    counts = counts_per_control(model)
    for one in designs:
        entry = axis_entry(one.nominal, one.loop.margins, one.design, DIRECT)
        entry["gains"] = dict(zip(DIRECT, one.gains.as_tuple(), strict=True))
        factor = counts[AXES.index(one.axis)]
        entry["on_control"] = {name: g / factor for name, g in entry["gains"].items()}
        entry["reasons"] = _reasons(one, limits)
        entry["notes"] = [
            f"at maximum sensitivity {limits.sensitivity:g} no PID behind these motors overshoots"
            f" less than {one.design.calmest:.0f} % or settles faster than"
            f" {one.design.fastest:.3f} s",
            "on u' these gains are "
            + ", ".join(f"{name} {g:.4g}" for name, g in entry["on_control"].items()),
        ]
        axes[one.axis] = entry
    notes = [
        limits_line(limits),
        f"flown through steps of {' and '.join(f'{one:g}' for one in STEPS_RAD)} rad, the worse"
        f" counts; motors at a stop for"
        f" {1e3 * AT_STOPS_S:g} ms at most",
    ]
    return {"form": "whole", "max_sensitivity": limits.sensitivity, "axes": axes, "notes": notes}


def whole_page(
    model: Model,
    name: str,
    designs: Sequence[WholeDesign],
    report: dict[str, Any],
    delay: int | None = None,
) -> Page:
    """The design for people: steps, responses, fronts, reasons."""
    page = Page(f"PID behind motors for {name}", LOOP_NAMES["whole"])
    page.table(DESIGN_HEAD, [design_row(axis, e) for axis, e in report["axes"].items()])
    gains = {one.axis: one.gains for one in designs}
    seconds = max(WINDOW_S[one.axis] for one in designs)
    flown = evaluate(model, gains, "whole", seconds, delay)
    page.figure(step_figure(flown), f"Steps of {WHOLE_STEP_RAD:g} rad, all blocks in the loop.")
    loops = {one.axis: one.loop for one in designs}
    add_loop_figures(page, loops, BROKEN_AT["whole"], report["max_sensitivity"])
    for one in designs:
        page.heading(one.axis)
        entry = report["axes"][one.axis]
        page.table(GAINS_HEAD, gain_rows(entry["gains"], "whole", dict(PURPOSES)))
        page.bullets([*entry["reasons"], *entry["notes"]])
        page.figure(
            front_figure(one.axis, one.design, one.nominal),
            "Gains that no others beat in overshoot, settling and maximum sensitivity at once.",
        )
    page.bullets(report["notes"])
    return page


def inputs_page(followed: Followed, gains: str, model: str) -> Page:
    """A joystick on the whole loop: angles beside what was asked, motors, battery."""
    told = followed.as_dict()
    page = Page(f"{followed.inputs.name} flown by {gains}", f"{LOOP_NAMES['whole']}; {model}")
    page.table(
        ("axis", "RMS error deg", "largest deg"),
        [
            (axis, f"{e['rms_deg']:.2f}", f"{e['largest_deg']:.2f}")
            for axis, e in told["axes"].items()
        ],
        f"Motors at a stop {told['at_stops_pct']:.1f} % of {told['seconds']:.1f} s.",
    )
    page.figure(inputs_figure(followed), "Asked (orange) and flown angles; motors; battery.")
    return page


def inputs_figure(followed: Followed) -> Figure:
    """Five panels over time: three angles, four motors, the battery."""
    made, panels = figure(rows=5, height=8.0, sharex=True)
    rows = np.unique(np.linspace(0, len(followed.response.pwm) - 1, MOST_POINTS).astype(int))
    time = rows * SAMPLE_PERIOD_S
    for index, (panel, axis) in enumerate(zip(panels, AXES, strict=False)):
        panel.plot(time, np.degrees(followed.inputs.attitude[rows, index]), color=MODELLED)
        panel.plot(time, np.degrees(followed.response.angles[rows, index]), color=IMPROVED)
        panel.set_ylabel(f"{axis}, deg")
    for index, color in enumerate(SERIES[:4]):
        share = 100.0 * followed.response.pwm[rows, index] / PWM_FULL
        panels[3].plot(time, share, color=color, linewidth=0.9, label=f"M{index + 1}")
    panels[3].set_ylabel("duty, %")
    panels[3].set_ylim(0.0, 100.0)
    panels[3].legend(loc="upper right", ncols=4)
    panels[4].plot(time, followed.inputs.supply_mv[rows] / 1e3, color=MEASURED)
    panels[4].set_ylabel("battery, V")
    panels[4].set_xlabel("s")
    return made


def _reasons(one: WholeDesign, limits: Limits) -> list[str]:
    """One line a gain: what it is for, and what a quarter more or a fifth less would do."""
    values = np.array(one.gains.as_tuple())
    lines = []
    for index, (name, purpose) in enumerate(PURPOSES):
        rows = np.array([values, values])
        rows[0, index] *= 1.25
        rows[1, index] *= 0.8
        more, less = one.judge(rows)
        lines.append(
            f"{name} = {values[index]:.4g}: {purpose}; 25 % more: {outcome(more, limits)};"
            f" 20 % less: {outcome(less, limits)}"
        )
    return lines
