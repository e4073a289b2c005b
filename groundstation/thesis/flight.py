"""Figures 7.13 to 7.25: what a flight's recording becomes before anything is fitted to it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from groundstation.dynamics.model import model_vehicle, rotor_motors
from groundstation.dynamics.simulation import armature_mv
from groundstation.identification.division import Stretch, stretches_of
from groundstation.identification.fit_record import liveliest
from groundstation.identification.runs import Run, rotor_squares
from groundstation.report.page import against, lines
from groundstation.telemetry.arrays import AXES, Array
from groundstation.thesis.entry import Entry, Made
from groundstation.thesis.workshop import Workshop

EXAMPLE_S = 4.0


def airborne(workshop: Workshop, name: str) -> list[Stretch]:
    """The stretches of a flight in the air, their rotors by the fitted motor."""
    motors = rotor_motors(workshop.model("body.json"))
    runs = workshop.runs(name)
    return workshop.once(("airborne", name), lambda: stretches_of(runs, motors))


def longest(workshop: Workshop, name: str = "flight.csv") -> Run:
    """The longest stretch in the air as a run of its own."""
    one = max(airborne(workshop, name), key=len)
    return one.run[one.rows]


def torque(workshop: Workshop, run: Run) -> Array:
    """u' (n, 3) of eq. 7.19."""
    model = workshop.model("body.json")
    return rotor_squares(run, rotor_motors(model)).mixed(model_vehicle(model).configuration)


def _voltages(one: int, other: int) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        run = longest(workshop)
        volts = armature_mv(run.duty, run.supply_v) / 1e3
        full = 100.0 * float((run.duty[:, [one, other]] >= 0.995).any(axis=1).mean())
        return Made(
            f"Duty times the reported battery voltage (3.84). Saturated in {full:.1f} % of the"
            " rows; the thesis's tops are flat where they are.",
            figures=[
                lines(run.time_s, {f"M{i + 1}": volts[:, i] for i in (one, other)}, "V"),
            ],
        )

    return make


def _speeds(one: int, other: int) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        run = longest(workshop)
        speed = np.sqrt(rotor_squares(run, rotor_motors(workshop.model("body.json"))).end)
        return Made(
            "By the fitted motor (7.10) from the voltages.",
            figures=[lines(run.time_s, {f"M{i + 1}": speed[:, i] for i in (one, other)}, "rev/s")],
        )

    return make


def _torque(axis: int) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        run = longest(workshop)
        mixed = torque(workshop, run)[:, axis]
        return Made(
            f"u'{axis + 1} of the mixer (7.19): between {mixed.min():.0f} and {mixed.max():.0f}"
            f" (rev/s)^2, mean {mixed.mean():.0f}.",
            figures=[lines(run.time_s, {AXES[axis]: mixed}, "u', (rev/s)^2")],
        )

    return make


def _angle(axis: int) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        run = longest(workshop)
        angle = np.degrees(run.attitude[:, axis])
        return Made(
            f"As reported, {angle.min():.1f} to {angle.max():.1f} deg.",
            figures=[lines(run.time_s, {AXES[axis]: angle}, "deg")],
        )

    return make


def _example(axis: int) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        run = longest(workshop)
        rows = liveliest(run.attitude[:, axis], run.period_s, EXAMPLE_S)
        return Made(
            f"The {EXAMPLE_S:.0f} s in which {AXES[axis]} moves most: angle, and dashed the"
            " torque behind it.",
            figures=[
                against(
                    run.time_s[rows],
                    np.degrees(run.attitude[rows, axis]),
                    f"{AXES[axis]}, deg",
                    torque(workshop, run)[rows, axis],
                    "u', (rev/s)^2",
                )
            ],
        )

    return make


ENTRIES = (
    Entry("Figure 7.13", "Motor1 and Motor3 armature voltages", _voltages(0, 2)),
    Entry("Figure 7.14", "Motor2 and Motor4 armature voltages", _voltages(1, 3)),
    Entry("Figure 7.15", "Rotational speeds of Motor1 and Motor3", _speeds(0, 2)),
    Entry("Figure 7.16", "Rotational speeds of Motor2 and Motor4", _speeds(1, 3)),
    Entry("Figure 7.17", "Roll torque respect to the k constant", _torque(0)),
    Entry("Figure 7.18", "Pitch torque respect to the k constant", _torque(1)),
    Entry("Figure 7.19", "Yaw torque respect to the b constant", _torque(2)),
    Entry("Figure 7.20", "Roll angle of the flight data", _angle(0)),
    Entry("Figure 7.21", "Pitch angle of the flight data", _angle(1)),
    Entry("Figure 7.22", "Yaw angle of the flight data", _angle(2)),
    Entry("Figure 7.23", "Real-time flight data example-1", _example(0)),
    Entry("Figure 7.24", "Real-time flight data example-2", _example(1)),
    Entry("Figure 7.25", "Real-time flight data example-3", _example(2)),
)
