"""What a design for the whole loop reports: numbers for programs, a page for people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from groundstation.control.design import Limits
from groundstation.control.design_report import (
    DESIGN_HEAD,
    DIRECT,
    axis_entry,
    design_row,
    limits_line,
    outcome,
)
from groundstation.control.evaluate import WHOLE_STEP_RAD, evaluate
from groundstation.control.loop_figures import add_loop_figures
from groundstation.control.pid import AXES
from groundstation.control.report import BROKEN_AT, LOOP_NAMES, front_figure, step_figure
from groundstation.control.thesis_loop import counts_per_control
from groundstation.control.whole_design import AT_STOPS_S, WINDOW_S, WholeDesign
from groundstation.dynamics.model import Model
from groundstation.report.page import Page

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
        f"flown through steps of {WHOLE_STEP_RAD:g} rad; motors at a stop for"
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
        page.bullets([*entry["reasons"], *entry["notes"]])
        page.figure(
            front_figure(one.axis, one.design, one.nominal),
            "Gains that no others beat in overshoot, settling and maximum sensitivity at once.",
        )
    page.bullets(report["notes"])
    return page


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
