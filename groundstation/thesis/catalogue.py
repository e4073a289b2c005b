"""The thesis's entries in printed order, those on telemetry, fusion and control, and their
page.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.attitude.fusion import angles_figure, axis_figure, check_axes, fuse
from groundstation.control.firmware_loop import load_gains
from groundstation.control.linear_loop import (
    FINDING,
    GAINS,
    ROUNDED_ROLL,
    ROUNDED_YAW,
    evaluate,
    printed_plant,
    step_direct,
    window_s,
)
from groundstation.dynamics.model import THESIS
from groundstation.errors import BadInputError
from groundstation.report.page import Cell, Page, lines
from groundstation.telemetry.arrays import AXES
from groundstation.telemetry.packet import PACKET_DTYPE, SAMPLE_PERIOD_S
from groundstation.thesis.identification import ARX, BODY, FLIGHTS, MOTORS
from groundstation.thesis.workshop import PACKET as PRINTED
from groundstation.thesis.workshop import (
    WHOLE_GAINS,
    WITHOUT,
    Done,
    Entry,
    Made,
    Table,
    Workshop,
    responses,
)

# Table 5.1 and Figure 5.7: the packet and the log.


def _packet(workshop: Workshop) -> Made:
    rows: list[list[Cell]] = []
    fields: Any = PACKET_DTYPE.fields
    for (data, unit, size), name in zip(PRINTED, PACKET_DTYPE.names or (), strict=True):
        dtype, offset = fields[name][:2]
        rows.append([data, unit, size, name, offset, dtype.itemsize])
    head = ["data", "printed unit", "printed bytes", "field here", "at byte", "bytes"]
    return Made(
        "The same 32 bytes; units and signs of each field are in docs/hardware.md. The motors are"
        " 12 bits each, packed.",
        [Table(head, rows, f"{PACKET_DTYPE.itemsize} bytes in all.")],
    )


def _log(workshop: Workshop) -> Made:
    samples = workshop.samples("excerpt.csv")
    quality = workshop.said("excerpt.json")
    time = samples.time_s - samples.time_s[0]
    gyro = np.degrees(samples.gyro)
    accelerometer = samples.accelerometer / 9.80665
    return Made(
        f"The 25 printed rows, read as any recording is: {quality['samples']} samples at"
        f" {quality['rate_hz']:.1f} Hz, {quality['lost_samples']} lost,"
        f" {quality['gap_count']} gaps."
        " The accelerometer shows the rotors' imbalance, folded to nearly half the sample rate.",
        [
            Table(
                ["printed row 8517", "printed", "decoded"],
                [
                    ["Timestamp", "17114118", f"{samples.ticks[0]} ticks"],
                    ["Battery", "3242", f"{samples.battery_v[0]:.3f} V"],
                    ["Motor1", "3376", f"{100 * samples.duty[0, 0]:.1f} % duty"],
                    ["GyroX", "-445", f"{gyro[0, 0]:.2f} deg/s"],
                    ["AccZ", "7707", f"{accelerometer[0, 2]:.3f} g"],
                    ["Pitch", "-559", f"{np.degrees(samples.attitude[0, 1]):.2f} deg, nose down"],
                ],
            )
        ],
        [
            lines(time, dict(zip("xyz", table.T, strict=True)), label)
            for table, label in ((gyro, "gyro, deg/s"), (accelerometer, "accelerometer, g"))
        ],
    )


# Figures 6.3 to 6.5: sensor fusion by hand, and the axes.


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


# Figures 8.10 and 8.12 to 8.18, Tables 8.1 to 8.7: the controllers.


DRAWN = (("roll", 2), ("roll", 8), (ROUNDED_ROLL, 2), ("yaw", 8), (ROUNDED_YAW, 8))
COLUMNS = (("roll", 2), (ROUNDED_ROLL, 2), (ROUNDED_YAW, 2), (ROUNDED_YAW, 8))
WHOLE_S, WHOLE_DELAY = 1.0, 2


def _gains(workshop: Workshop, name: str) -> Made:
    workshop.use("controllers.json")
    keys = ("kp", "ki", "kd")
    rows = [[key, *(getattr(GAINS[name][axis], key) for axis in AXES)] for key in keys]
    says = "Taken as printed: they act on u' in (rev/s)^2 per rad."
    tables = [Table(["printed", *AXES], rows)]
    if name == "PID":
        one = workshop.said("limits.json")["axes"]["roll"]
        says += (
            " Beside them what a search gives on the printed roll model with 2 samples of"
            f" delay and a maximum sensitivity of 2: overshoot {one['overshoot_pct']:.0f} %,"
            f" settled in {one['settling_s']:.3f} s."
        )
        tables.append(Table(["by search", "roll"], [[key, one["gains"][key]] for key in keys]))
    return Made(says, tables)


def _steps(workshop: Workshop, name: str) -> Made:
    workshop.use("controllers.json")
    panels: dict[str, list[tuple[str, Any]]] = {"roll": [], "yaw": []}
    for label, delay in DRAWN:
        axis = label.split(",")[0]
        plant = printed_plant(label, delay)
        y = step_direct(plant, GAINS[name][axis], window_s(label))
        rounded = "" if label == axis else f", {label.split(', ')[1]}"
        panels[axis].append((f"{delay} rows{rounded}", np.nan_to_num(y, nan=5.0)))
    return Made(
        f"{name} with the printed gains on the printed models, with delays in rows, and on"
        " models within the rounding of their digits; pitch is roll.",
        figures=[responses(panels, SAMPLE_PERIOD_S)],
    )


def _results(workshop: Workshop, key: str, unit: str, scale: str) -> Made:
    cases = {
        (case["controller"], case["axis"], case["delay_samples"]): case
        for case in workshop.said("controllers.json")
    }

    def told(case: dict[str, Any]) -> str:
        if not case["stable"]:
            return "unstable"
        return "not settled" if case[key] is None else f"{case[key]:{scale}}"

    head, rows = [""], [[name] for name in GAINS]
    for axis in ("roll", "yaw"):
        columns = [one for one in COLUMNS if one[0].split(",")[0] == axis]
        head += [f"printed {axis}", *(f"{label}, {delay} rows" for label, delay in columns)]
        for row, name in zip(rows, GAINS, strict=True):
            row.append(f"{cases[name, axis, 2]['printed'][key]:{scale}}")
            row += [told(cases[name, label, delay]) for label, delay in columns]
    says = (FINDING + " ") * (key == "rms") + f"In {unit}; pitch is roll."
    return Made(says, [Table(head, rows)])


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


# All entries in printed order, and how they are made.


ENTRIES: tuple[Entry, ...] = (
    Entry("Table 5.1", "Telemetry data structure", _packet),
    Entry("Figure 5.7", "Data log example", _log),
    Entry("Figure 6.3", "Kalman fusion output", _fusion),
    Entry("Figure 6.4", "Crazyflie axis test no. 1", _inverted),
    Entry("Figure 6.5", "Crazyflie axis test no. 2", _corrected),
    *MOTORS,
    *FLIGHTS,
    *BODY,
    *ARX,
    Entry("Figure 8.10", "Whole simulation diagram", _whole),
    *(
        entry
        for i, kind in enumerate(GAINS)
        for entry in (
            Entry(f"Figure 8.{12 + 2 * i}", f"{kind} controller results", _steps, (kind,)),
            Entry(f"Table 8.{1 + i}", f"{kind} controller gains", _gains, (kind,)),
        )
    ),
    Entry("Table 8.5", "Controller RMS errors", _results, ("rms", "rad of a step of 1 rad", ".4f")),
    Entry(
        "Table 8.6", "Overshoot ratios", _results, ("overshoot_pct", "percent of the step", ".0f")
    ),
    Entry("Table 8.7", "Settling times", _results, ("settling_s", "s, into 5 %", ".2f")),
)


def chosen(numbers: Sequence[str]) -> list[Entry]:
    """Entries by number ("7.1", "Table 7.1"); all where none is named.

    Raises BadInputError for a number that has no counterpart.
    """
    for wanted in numbers:
        if not any(wanted in one.names for one in ENTRIES):
            raise BadInputError(
                f"--only {wanted}: there are {', '.join(one.number for one in ENTRIES)}"
            )
    return [one for one in ENTRIES if not numbers or one.names & set(numbers)]


def make(
    workshop: Workshop, entries: Sequence[Entry], begin: Callable[[int, Entry], None]
) -> list[Done]:
    """Each entry with the commands that made it. begin: told of each before it."""
    done = []
    for number, entry in enumerate(entries):
        begin(number, entry)
        workshop.begin()
        made = entry.make(workshop, *entry.given)
        done.append(Done(entry, made, *workshop.commands()))
    return done


# The page and the JSON of what was made.


def page(done: Sequence[Done], seconds: float) -> Page:
    """One page, a section for each number."""
    made = Page("The thesis, repeated", f"{len(done)} entries, made in {seconds:.0f} s")
    made.verdict(
        "Modeling, Identification and Simulation of a Quadrotor Using Real-Time Flight Data (M.Sc."
        " thesis, Istanbul Technical University, May 2015, on a Crazyflie 1.0):"
        f" {len(done)} of its tables and figures made again, {len(WITHOUT)} have no counterpart."
    )
    made.next_step("see under each number what was done, and the commands that do it again.")
    made.text(
        "Every table and figure of the thesis that has a counterpart, in printed order, made from"
        " the stand-in, whose true constants are known, and from the 25 printed rows of Figure 5.7;"
        " the thesis's own recordings are not published. So numbers are not expected to agree with"
        " the printed ones: compared is what each procedure finds, and whether it is the truth."
    )
    made.heading("What came out")
    made.table(
        ["number", "what it is", "what came out"],
        [
            (
                one.entry.number.replace(" ", "\u00a0"),  # in one line
                one.entry.title,
                re.split(r"(?<=[.]) (?=[A-Z])", one.made.says)[0],  # its first sentence
            )
            for one in done
        ],
    )
    for one in done:
        made.heading(one.entry.number)
        made.text(f"{one.entry.title}.")
        for table in one.made.tables:
            made.table(table.head, table.rows, table.caption)
        for drawn in one.made.figures:
            made.figure(drawn, f"{one.entry.number}: {one.entry.title}")
        made.text(one.made.says)
        if one.commands:
            made.code(one.commands)
    made.heading("Without a counterpart")
    made.table(["number", "what it is"], WITHOUT)
    made.heading("Commands")
    made.text(
        "All, in order, for a folder with the files that groundstation thesis puts there first"
        " (excerpt.csv, hand.toml, printed.toml); commands.sh there runs them anew."
    )
    made.code(dict.fromkeys(line for one in done for line in one.chain))
    return made


def as_json(done: Sequence[Done], seconds: float) -> dict[str, Any]:
    """For programs."""
    return {
        "entries": [
            {
                "number": one.entry.number,
                "title": one.entry.title,
                "says": one.made.says,
                "tables": [{"head": table.head, "rows": table.rows} for table in one.made.tables],
                "figures": len(one.made.figures),
                "commands": list(one.commands),
                "from_nothing": list(one.chain),
            }
            for one in done
        ],
        "without": [{"number": number, "why": why} for number, why in WITHOUT],
        "seconds": round(seconds, 1),
    }
