"""Figures 8.10 and 8.12 to 8.18, Tables 8.1 to 8.7: the controllers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.control.firmware_loop import load_gains
from groundstation.control.linear_loop import (
    FINDING,
    GAINS,
    ROUNDED_ROLL,
    ROUNDED_YAW,
    evaluate,
    printed_plant,
    run_direct,
    window_s,
)
from groundstation.dynamics.model import THESIS
from groundstation.report.page import Cell
from groundstation.telemetry.arrays import AXES
from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.thesis.drawing import responses
from groundstation.thesis.entry import Entry, Made, Table
from groundstation.thesis.workshop import WHOLE_GAINS, Workshop

DRAWN = (("roll", 2), ("roll", 8), (ROUNDED_ROLL, 2), ("yaw", 8), (ROUNDED_YAW, 8))
COLUMNS = (("roll", 2), (ROUNDED_ROLL, 2), (ROUNDED_YAW, 2), (ROUNDED_YAW, 8))
WHOLE_S, WHOLE_DELAY = 1.0, 2


def _gains(name: str) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        workshop.use("controllers.json")
        rows = [
            [key, *(getattr(GAINS[name][axis], key) for axis in AXES)] for key in ("kp", "ki", "kd")
        ]
        says = "Taken as printed: they act on u' in (rev/s)^2 per rad."
        tables = [Table(["printed", *AXES], rows)]
        if name == "PID":
            one = workshop.said("limits.json")["axes"]["roll"]
            gains = [[key, one["gains"][key]] for key in ("kp", "ki", "kd")]
            says += (
                " Beside them what a search gives on the printed roll model with 2 samples of"
                f" delay and a maximum sensitivity of 2: overshoot {one['overshoot_pct']:.0f} %,"
                f" settled in {one['settling_s']:.3f} s."
            )
            tables.append(Table(["by search", "roll"], gains))
        return Made(says, tables)

    return make


def _steps(name: str) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        workshop.use("controllers.json")
        panels: dict[str, list[tuple[str, Any]]] = {"roll": [], "yaw": []}
        for label, delay in DRAWN:
            axis = label.split(",")[0]
            plant = printed_plant(label, delay)
            rows = round(window_s(label) / plant.ts)
            with np.errstate(over="ignore", invalid="ignore"):
                y = run_direct(plant, GAINS[name][axis], np.ones(rows)).y
            rounded = "" if label == axis else f", {label.split(', ')[1]}"
            panels[axis].append((f"{delay} rows{rounded}", np.nan_to_num(y, nan=5.0)))
        return Made(
            f"{name} with the printed gains on the printed models, with delays in rows, and on"
            " models within the rounding of their digits; pitch is roll.",
            figures=[responses(panels, SAMPLE_PERIOD_S)],
        )

    return make


def _results(key: str, unit: str, scale: str) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        cases = {
            (case["controller"], case["axis"], case["delay_samples"]): case
            for case in workshop.said("controllers.json")
        }
        rows: list[list[Cell]] = []
        for name in GAINS:
            row: list[Cell] = [name]
            for axis in ("roll", "yaw"):
                row.append(f"{cases[name, axis, 2]['printed'][key]:{scale}}")
                for label, delay in COLUMNS:
                    if label.split(",")[0] != axis:
                        continue
                    case = cases[name, label, delay]
                    value = case[key]
                    row.append(
                        "unstable"
                        if not case["stable"]
                        else "not settled"
                        if value is None
                        else f"{value:{scale}}"
                    )
            rows.append(row)
        head = ["", "printed roll"]
        head += [f"{label}, {delay} rows" for label, delay in COLUMNS[:2]]
        head += ["printed yaw"]
        head += [f"{label}, {delay} rows" for label, delay in COLUMNS[2:]]
        return Made(
            (FINDING + " ") * (key == "rms") + f"In {unit}; pitch is roll.", [Table(head, rows)]
        )

    return make


def _whole(workshop: Workshop) -> Made:
    said = workshop.said("whole.json")["axes"]
    gains = load_gains(Path(workshop.use(WHOLE_GAINS)))
    rows: list[list[Cell]] = []
    drawn: dict[str, list[tuple[str, Any]]] = {}
    for one in evaluate(THESIS, gains, "whole", WHOLE_S, WHOLE_DELAY):
        mine = said[one.axis]
        error = f"{mine['rms']:.3f}" if mine["stable"] else "diverges"
        rows.append([one.axis, mine["gains"]["kp"], mine["gains"]["kd"], error])
        drawn[one.axis] = [("PD", one.response)]
    return Made(
        "The whole simulation: reference, PID, +-4096 counts, power distribution (8.3), battery,"
        " motors, mixer, ARX bodies (7.32 to 7.34), here with 2 rows of delay. Its gains are the"
        " printed PD's (Table 8.3) in counts per rad, by what a count does to u' at hover; a step"
        " of 0.2 rad. Roll and pitch stand at their limits at once and are lost: the printed"
        " tables belong to a loop without motors and limits.",
        [Table(["axis", "kp, counts/rad", "kd", "RMS, rad"], rows)],
        [responses(drawn, SAMPLE_PERIOD_S)],
    )


ENTRIES = (
    Entry("Figure 8.10", "Whole simulation diagram", _whole),
    Entry("Figure 8.12", "P controller results", _steps("P")),
    Entry("Table 8.1", "P controller gains", _gains("P")),
    Entry("Figure 8.14", "PI controller results", _steps("PI")),
    Entry("Table 8.2", "PI controller gains", _gains("PI")),
    Entry("Figure 8.16", "PD controller results", _steps("PD")),
    Entry("Table 8.3", "PD controller gains", _gains("PD")),
    Entry("Figure 8.18", "PID controller results", _steps("PID")),
    Entry("Table 8.4", "PID controller gains", _gains("PID")),
    Entry("Table 8.5", "Controller RMS errors", _results("rms", "rad of a step of 1 rad", ".4f")),
    Entry("Table 8.6", "Overshoot ratios", _results("overshoot_pct", "percent of the step", ".0f")),
    Entry("Table 8.7", "Settling times", _results("settling_s", "s, into 5 %", ".2f")),
)
