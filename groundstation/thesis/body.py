"""Figures 7.27 to 7.31, Table 7.2: the grey box of the body."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from groundstation.dynamics.model import THESIS, Model, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.fit_record import liveliest
from groundstation.identification.report import angle_rms, simulate_run
from groundstation.report.page import Cell
from groundstation.telemetry.arrays import AXES, Array
from groundstation.thesis.drawing import overlay
from groundstation.thesis.entry import Entry, Made, Table
from groundstation.thesis.flight import longest
from groundstation.thesis.printed import BODY_RMS
from groundstation.thesis.workshop import Workshop

WINDOWS_S = (0.5, 2.0)
DRAWN_S = 6.0
FILES = {"identification": "flight.csv", "validation": "held.csv"}


def by_roll(model: Model) -> Model:
    """The model with roll's constant for pitch, as in the thesis."""
    body = model.body
    if body is None:
        return model
    return msgspec.structs.replace(model, body=msgspec.structs.replace(body, c1=body.c0))


def _rms(workshop: Workshop, axis: str, part: str, window_s: float) -> float:
    def make() -> Array:
        model = by_roll(workshop.model("body.json"))
        return angle_rms(model, [longest(workshop, FILES[part])], window_s)

    return float(workshop.once(("angle rms", part, window_s), make)[AXES.index(axis)])


def _table(workshop: Workshop) -> Made:
    rows: list[list[Cell]] = [
        [f"{axis}, {part}", printed, *(_rms(workshop, axis, part, w) for w in WINDOWS_S)]
        for (axis, part), printed in BODY_RMS.items()
    ]
    found = workshop.model("body.json")
    craft = vehicle_model(load_vehicle("crazyflie1")).body
    constants = [
        [name, *(getattr(one, name) for one in (THESIS.body, found.body, craft) if one)]
        for name in ("c0", "c1", "c2")
    ]
    said = found.fit["body"]["estimates"]
    error = dict(zip(said["names"], said["stderr"], strict=True))
    constants = [[*row[:3], error[str(row[0])], row[3]] for row in constants]
    return Made(
        "RMS of the angles in rad when the fitted body runs freely from measured rates and angles;"
        " pitch by roll's constant, as in the thesis. How long a run lasts decides what is read"
        " off, which the thesis does not say: runs of 2 s come near the printed errors of roll and"
        " yaw. An unstable plant's free run measures how disturbances add up. The fit itself"
        " predicts rates one row ahead, with a noise model.",
        [
            Table(["data fit", "printed", *(f"runs of {w:g} s" for w in WINDOWS_S)], rows),
            Table(
                ["constant", "printed (7.18)", "fitted", "standard error", "true of the stand-in"],
                constants,
                "The printed constants are another craft's.",
            ),
        ],
    )


def _fit(axis: str, part: str, with_roll: bool = False) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        run = longest(workshop, FILES[part])
        index = AXES.index(axis)
        rows = liveliest(run.attitude[:, index], run.period_s, DRAWN_S)
        model = by_roll(workshop.model("body.json"))
        done = workshop.once(("replayed", part), lambda: simulate_run(model, run, max(WINDOWS_S)))
        error = _rms(workshop, axis, part, max(WINDOWS_S))
        words = " by roll's constant" if with_roll else ""
        measured = np.unwrap(run.attitude, axis=0)[rows, index]
        apart = np.angle(np.exp(1j * (measured - done.attitude[rows, index])))
        return Made(
            f"Free runs of {max(WINDOWS_S):g} s each{words}: RMS {error:.3f} rad over the flight,"
            f" printed {BODY_RMS[axis, part]:.4f}.",
            figures=[
                overlay(
                    run.time_s[rows],
                    np.degrees(measured),
                    np.degrees(measured - apart),
                    f"{axis}, deg",
                    "free run",
                )
            ],
        )

    return make


ENTRIES = (
    Entry("Figure 7.27", "Roll axis identification data fit", _fit("roll", "identification")),
    Entry("Figure 7.28", "Roll axis validation data fit", _fit("roll", "validation")),
    Entry("Figure 7.29", "Pitch axis validation data fit", _fit("pitch", "validation", True)),
    Entry("Figure 7.30", "Yaw axis identification data fit", _fit("yaw", "identification")),
    Entry("Figure 7.31", "Yaw axis validation data fit", _fit("yaw", "validation")),
    Entry("Table 7.2", "Results of nonlinear grey-box identification", _table),
)
