"""Figures 7.3 to 7.6 and 7.9 to 7.11, Table 7.1: the motor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from groundstation.dynamics.model import THESIS
from groundstation.dynamics.simulation import armature_mv
from groundstation.identification.flight import turning_parts
from groundstation.identification.motor.fit import bench_run, simulate_run, speed_from_gate
from groundstation.identification.runs import Run
from groundstation.report.page import Cell, lines, points
from groundstation.thesis.drawing import overlay
from groundstation.thesis.entry import Entry, Made, Table
from groundstation.thesis.printed import MOTOR_FIT
from groundstation.thesis.workshop import Workshop

FROM_S, TO_S = 20.0, 28.0
"""The 4000 samples that are fitted."""
START_S, PIECE_S, DRAWN_S = 0.5, 2.0, 8.0


def _part(run: Run, first_s: float, last_s: float) -> Run:
    first, last = (
        round((s + run.recording_start_s - run.start_s) / run.period_s) for s in (first_s, last_s)
    )
    return run[max(first, 0) : last]


def _piece(workshop: Workshop) -> Run:
    return _part(workshop.runs("bench.csv")[0], FROM_S, TO_S)


def _periods(workshop: Workshop) -> Made:
    run = _piece(workshop)
    gate = speed_from_gate(run)
    return Made(
        "Half a revolution, as the optical gate times it, over the 8 s that are fitted:"
        f" {100 * gate.glitches:.1f} % of the readings are missed or doubled passages.",
        figures=[points(run.time_s, {"gate": 1e3 * run.debug_s}, "half period, ms")],
    )


def _filtered(workshop: Workshop) -> Made:
    run = _piece(workshop)
    gate = speed_from_gate(run)
    kept = np.isfinite(gate.rev_s)
    return Made(
        "Readings that differ by more than 10 % from the median of those around them are left out"
        " (the thesis does not say how its filter works), and nothing is put in their place.",
        figures=[points(run.time_s[kept], {"kept": 500.0 / gate.rev_s[kept]}, "half period, ms")],
    )


def _speed(workshop: Workshop) -> Made:
    run = _piece(workshop)
    gate = speed_from_gate(run)
    kept = np.isfinite(gate.rev_s)
    return Made(
        "One over twice the half period.",
        figures=[lines(run.time_s[kept], {"M1": gate.rev_s[kept]}, "rev/s")],
    )


def _voltage(workshop: Workshop) -> Made:
    run = _piece(workshop)
    voltage = armature_mv(run.duty, run.supply_v)[:, 0] / 1e3
    return Made(
        "Duty times the reported battery voltage (3.84).",
        figures=[lines(run.time_s, {"M1": voltage, "battery": run.supply_v}, "V")],
    )


def _results(workshop: Workshop) -> Made:
    true = THESIS.motor
    rows: list[list[Cell]] = [
        ["printed (7.10)", *MOTOR_FIT.values(), true.a0, true.a1, true.a2],
    ]
    for name, words in (
        ("motor.json", "8 s, battery as reported (3.84)"),
        ("supplied.json", "60 s, sag and lag of the battery modelled"),
    ):
        model = workshop.model(name)
        account = model.fit["motor"]
        motor = model.motor
        held = {one["recording"]: one["rotor_fit_percent"] for one in account["validation"]}
        own = float(np.mean(account["identification"]["rotor_fit_percent"]))
        rows.append([words, own, *held.values(), motor.a0, motor.a1, motor.a2])
    rows.append(["true of the stand-in", None, None, None, true.a0, true.a1, true.a2])
    return Made(
        "The reported voltage passes a filter of 155 ms and does not know what wires lose. Taking"
        " it for the armature's, as 3.84 does, costs 15 % of a0 and a1 while the fit still reads"
        " 97 %: fit percent is no proof of parameters.",
        [Table(["fit %", *MOTOR_FIT, "a0", "a1", "a2"], rows)],
    )


def _fit(name: str, number: int, words: str) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        motor = workshop.model("motor.json")
        account = motor.fit["motor"]
        if number == 0:
            run = _piece(workshop)
            percent = float(np.mean(account["identification"]["rotor_fit_percent"]))
        else:
            (run, *_) = turning_parts(workshop.runs(name)[0], PIECE_S)
            run = run[round(START_S / run.period_s) :]
            percent = account["validation"][number - 1]["rotor_fit_percent"]
        estimates = account["estimates"]
        values = dict(zip(estimates["names"], estimates["values"], strict=True))
        bench = bench_run(run[: round(DRAWN_S / run.period_s)], 0)
        modelled = simulate_run(bench, motor.motor, values["delay_s"])
        known = np.isfinite(bench.rev_s)
        time = run.time_s[: len(known)][known]
        return Made(
            f"Fit {percent:.1f} % (printed {MOTOR_FIT[words]:.2f} %), simulated from the voltage"
            f" alone; {DRAWN_S:.0f} s are drawn.",
            figures=[
                overlay(time, bench.rev_s[known], modelled[known], "rev/s", "simulated"),
            ],
        )

    return make


ENTRIES = (
    Entry("Figure 7.3", "Logged motor revolution period data", _periods),
    Entry("Figure 7.4", "Filtered motor revolution period data", _filtered),
    Entry("Figure 7.5", "Measured motor speed", _speed),
    Entry("Figure 7.6", "Armature voltage", _voltage),
    Entry("Table 7.1", "Motor model identification results", _results),
    Entry("Figure 7.9", "Identification data fit", _fit("bench.csv", 0, "identification")),
    Entry("Figure 7.10", "Validation-1 data fit", _fit("bench1.csv", 1, "validation 1")),
    Entry("Figure 7.11", "Validation-2 data fit", _fit("bench2.csv", 2, "validation 2")),
)
