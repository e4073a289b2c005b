"""What the thesis's entries are made with: flights, models, printed numbers, drawings."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from groundstation.control.firmware_loop import gains_text
from groundstation.control.linear_loop import GAINS
from groundstation.dynamics.model import Model, load_model
from groundstation.identification.runs import Run, runs_of
from groundstation.recording.formats import open_recording
from groundstation.report.page import (
    BAD,
    GOOD,
    MEASURED,
    MODELLED,
    NEUTRAL,
    SERIES,
    Cell,
    figure,
    thinned,
)
from groundstation.shell import Shell
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import SampleBatch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from groundstation.identification.estimate import CorrelationTest

# What the thesis prints of identification; of its controllers see ``control/linear_loop.py``.


PACKET = (
    ("Timestamp", "microseconds", "2"),
    ("Battery voltage", "millivolts", "2"),
    ("Motor PWM", "1:4096", "1.5 x 4"),
    ("Gyroscope axes", "degrees per second", "2 x 3"),
    ("Accelerometer axes", "g-force", "2 x 3"),
    ("Roll, pitch, yaw", "degrees", "2 x 3"),
    ("Debug / motor speed", "-", "4"),
)
"""Table 5.1: data, unit, bytes."""

MOTOR_FIT = {"identification": 86.80, "validation 1": 79.45, "validation 2": 91.73}
"""Table 7.1, fit in percent."""

BODY_RMS = {
    ("roll", "identification"): 0.0847,
    ("roll", "validation"): 0.1209,
    ("pitch", "validation"): 0.0345,
    ("yaw", "identification"): 0.0230,
    ("yaw", "validation"): 0.0181,
}
"""Table 7.2, rad."""

Order = tuple[int, int, int]
ROLL_ARX: dict[Order, tuple[float, float]] = {
    (2, 2, 0): (0.0134, 0.0277),
    (2, 1, 8): (0.0103, 0.0296),
    (2, 1, 9): (0.0099, 0.0301),
    (2, 1, 7): (0.0127, 0.0304),
    (2, 1, 6): (0.0140, 0.0309),
    (3, 1, 4): (0.0184, 0.0332),
    (4, 2, 0): (0.0192, 0.0340),
    (2, 2, 9): (0.0122, 0.0345),
    (2, 2, 6): (0.0157, 0.0367),
    (3, 1, 9): (0.0205, 0.0388),
    (3, 2, 9): (0.0207, 0.0392),
    (2, 1, 5): (0.0232, 0.0396),
    (2, 2, 8): (0.0163, 0.0413),
    (3, 1, 8): (0.0238, 0.0420),
    (4, 2, 9): (0.0256, 0.0446),
    (4, 1, 9): (0.0264, 0.0460),
    (2, 2, 2): (0.0223, 0.0463),
    (2, 2, 7): (0.0199, 0.0486),
    (4, 1, 8): (0.0316, 0.0523),
    (2, 1, 4): (0.0355, 0.0550),
}
"""Table 7.3: structure -> RMS in rad on identification and validation data, in printed order."""

YAW_ARX: dict[Order, tuple[float, float]] = {
    (2, 1, 8): (0.0129, 0.0140),
    (3, 2, 8): (0.0124, 0.0172),
    (2, 1, 7): (0.0142, 0.0277),
    (2, 2, 8): (0.0096, 0.0419),
    (2, 2, 7): (0.0115, 0.0461),
    (3, 2, 7): (0.0113, 0.0573),
    (2, 1, 9): (0.0091, 0.0694),
    (2, 2, 6): (0.0107, 0.0746),
    (3, 1, 9): (0.0089, 0.0795),
    (4, 2, 9): (0.0103, 0.0849),
    (3, 2, 9): (0.0101, 0.0896),
    (2, 2, 9): (0.0086, 0.0957),
    (2, 2, 5): (0.0094, 0.1056),
    (3, 1, 8): (0.0085, 0.1077),
    (3, 2, 6): (0.0096, 0.1149),
    (2, 1, 6): (0.0083, 0.1188),
    (2, 2, 4): (0.0090, 0.1229),
    (4, 2, 8): (0.0095, 0.1251),
    (3, 1, 7): (0.0081, 0.1309),
    (2, 1, 5): (0.0081, 0.1342),
}
"""Table 7.5, as Table 7.3."""

ROLL_ON_PITCH = 0.0411
"""Table 7.4: ARX(2,1,8) of roll on pitch, validation, rad."""

ROLL_STEPS = {
    (2, 2, 0): "too small to be true",
    (2, 1, 8): "plausible, chosen",
    (3, 1, 4): "not that of a free body",
    (4, 2, 0): "not that of a free body",
}
"""Figures 7.45 to 7.48: what the thesis says of the step responses."""

CROSS = {
    (2, 2, 0): "correlated",
    (2, 1, 8): "passes",
    (3, 1, 4): "correlated",
    (4, 2, 0): "correlated",
}
"""Figures 7.49 to 7.52: residuals against the input."""

WITHOUT = (
    ("Figures 1.1 to 1.14", "photographs of other quadrotors"),
    ("Figures 2.1, 2.2", "drawings of the configurations; signs and mixer: docs/hardware.md"),
    ("Figures 3.1 to 3.8", "block diagrams and drawings; the equations: docs/thesis_errata.md"),
    ("Figures 4.1 to 4.15", "photographs and diagrams of the craft and its sensors"),
    ("Figures 5.1 to 5.6", "photographs of the add-on; its protocol: docs/hardware.md"),
    ("Table 6.1, Figures 6.1, 6.2", "which sensors give which angles; drawings of sensor axes"),
    ("Figures 7.1, 7.2, 7.12, 7.32", "block diagrams of eq. 7.9, 3.82, 7.12-7.17 and 7.19"),
    ("Figures 7.7, 7.8, 7.26, 7.33", "screenshots of Matlab; here: docs/identification.md"),
    ("Figures 8.1 to 8.9", "block diagrams of the simulation; here: docs/pid.md"),
    ("Figures 8.11, 8.13, 8.15, 8.17", "block diagrams of the controllers, eq. 8.4 to 8.7"),
)
"""What has no counterpart, and why."""


# Flights, bench runs, models: each made by a command that anybody can type, when first needed.

Value = TypeVar("Value")

FLY = "python -m firmware_sim"
FITTED = ("dead_time", "rotor_acceleration_torque", "inertia_coupling", "rotor_gyroscopic_torque")
ORDERS = "--order 2,2,0 --order 2,1,8 --order 3,1,4 --order 4,2,0"
HELD = "--validate held.csv"
BENCHES = "--validate bench1.csv --validate bench2.csv"
RECIPES = {
    "excerpt.json": "groundstation inspect excerpt.csv --json > excerpt.json",
    "hand.csv": f"{FLY} --settings hand.toml --program hand_rotation --for 31 --fast -o hand.csv",
    "fused.json": "groundstation attitude hand.csv --json > fused.json",
    "axis.csv": f"{FLY} --program axis_check --seed 4 --for 23 --fast -o axis.csv",
    "axes.json": "groundstation axes axis.csv --json > axes.json",
    "bench.csv": f"{FLY} --program motor_bench --seed 11 --for 64 --fast -o bench.csv",
    "bench1.csv": f"{FLY} --program motor_bench --seed 12 --for 64 --fast -o bench1.csv",
    "bench2.csv": f"{FLY} --program motor_bench --seed 13 --for 64 --fast -o bench2.csv",
    "motor.json": f"groundstation fit motor bench.csv --segment 20:28 {BENCHES} -o motor.json",
    "supplied.json": "groundstation fit motor bench.csv --with battery_reading_lag,supply_sag"
    f" {BENCHES} -o supplied.json",
    "flight.csv": f"{FLY} --program thesis_flight --seed 21 --for 100 --fast -o flight.csv",
    "held.csv": f"{FLY} --program thesis_flight --seed 22 --for 100 --fast -o held.csv",
    "body.json": f"groundstation fit body flight.csv {HELD} --model supplied.json"
    f" --with {','.join(FITTED)} -o body.json",
    "arx.json": f"groundstation fit arx flight.csv {HELD} --model body.json {ORDERS} -o arx.json"
    " --html arx.html",
    "rates.json": f"groundstation fit arx flight.csv {HELD} --model body.json --gyro --decimate 4"
    " -o rates.json",
    "by_body.json": "groundstation compare held.csv --model body.json --json > by_body.json",
    "by_arx.json": "groundstation compare held.csv --model arx.json --json > by_arx.json",
    "by_rates.json": "groundstation compare held.csv --model rates.json --json > by_rates.json",
    "controllers.json": "python -m groundstation.control.linear_loop > controllers.json",
    "limits.json": "groundstation pid design --model thesis --loop direct --delay 2 --axis roll"
    " --json > limits.json",
    "whole.toml": "groundstation pid convert printed.toml --model thesis --to whole -o whole.toml",
    "whole.json": "groundstation pid evaluate --model thesis --loop whole --gains whole.toml"
    " --delay 2 --seconds 1 --json > whole.json",
}
"""File -> the command that makes it; the files it is made of are named in it."""
WHOLE_GAINS, PRINTED_GAINS = "whole.toml", "printed.toml"
"""The printed PD gains (Table 8.3), in PWM counts per rad and as printed."""
INPUTS = {"hand.toml": "[sensor]\ngyro_bias_dps = [1.5, -1.2, 0.8]\n"}


def inputs() -> dict[str, str]:
    """Files that the folder begins with, by name: the printed excerpt and settings."""
    excerpt = (files("groundstation.thesis") / "excerpt.csv").read_text(encoding="utf-8")
    return {**INPUTS, "excerpt.csv": excerpt, PRINTED_GAINS: gains_text(GAINS["PD"], loop="direct")}


class Workshop:
    """A folder in which files are made by their recipes, and read once.

    Raises GroundStationError with what a command said where it fails.
    """

    def __init__(self, shell: Shell) -> None:
        self._shell = shell
        self._kept: dict[Any, Any] = {}
        self._used: list[str] = []

    def begin(self) -> None:
        """Forget which files the last entry was made of."""
        self._used = []

    def commands(self) -> tuple[list[str], list[str]]:
        """The commands that made what was used since ``begin``, and those with all that they need;
        both in the order in which they make it from nothing."""
        direct = [line for name, line in RECIPES.items() if name in self._used]
        needed = dict.fromkeys(file for name in self._used for file in chain(name))
        return direct, [RECIPES[file] for file in needed]

    def use(self, name: str) -> str:
        """Make sure that a file is there; its full path."""
        if name not in self._used:
            self._used.append(name)
        for file in chain(name):
            if not (self._shell.folder / file).exists():
                command, _, into = RECIPES[file].partition(" > ")
                self._shell.run(*shlex.split(command), into=into or None)
        return str(self._shell.folder / name)

    def samples(self, name: str) -> SampleBatch:
        """A recording's rows."""
        path = self.use(name)
        return self.once(("samples", name), lambda: open_recording(path).samples)

    def runs(self, name: str) -> list[Run]:
        """A recording's runs."""
        samples = self.samples(name)
        return self.once(("runs", name), lambda: runs_of(samples, name))

    def model(self, name: str) -> Model:
        """A model file."""
        path = self.use(name)
        return self.once(("model", name), lambda: load_model(path))

    def said(self, name: str) -> Any:
        """What a command printed with --json."""
        path = Path(self.use(name))
        return self.once(("said", name), lambda: json.loads(path.read_text(encoding="utf-8")))

    def once(self, key: Any, make: Callable[[], Value]) -> Value:
        """What was made under this key before, or makes it."""
        if key not in self._kept:
            self._kept[key] = make()
        found: Value = self._kept[key]
        return found


def chain(name: str) -> list[str]:
    """The files whose commands make a file from nothing, in order, itself the last."""
    needed = [word for word in RECIPES.get(name, "").split() if word in RECIPES and word != name]
    first = dict.fromkeys(file for one in needed for file in chain(one))
    return [*first, name] if name in RECIPES else []


# A table or figure of the thesis, and what is made of it here.


@dataclass(frozen=True, slots=True)
class Table:
    """head: of the columns; "printed" in one says that its numbers are the thesis's."""

    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Made:
    """What stands on the page. says: what one sees, and what it means."""

    says: str
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


@dataclass(frozen=True, slots=True)
class Entry:
    """number: as printed, "Table 7.1". make: draws it from what the workshop has, and ``given``."""

    number: str
    title: str
    make: Callable[..., Made]
    given: tuple[Any, ...] = ()

    @property
    def names(self) -> set[str]:
        """What it is asked for by: "Table 7.1" and "7.1"."""
        return {self.number, self.number.split()[1]}


@dataclass(frozen=True, slots=True)
class Done:
    """An entry with the commands that made it, and ``chain``: these and all that they need, in the
    order in which they make it from nothing."""

    entry: Entry
    made: Made
    commands: Sequence[str]
    chain: Sequence[str]


# Figures that several entries share: models beside what was measured, correlations, steps.


LOST = (-3.0, 5.0)
"""A response over its step that leaves these bounds is not drawn further."""


def overlay(
    time_s: Array, measured: Array, modelled: Array, label: str, note: str = "modelled"
) -> Figure:
    """A measured channel and what a model makes of it."""
    made, (axes,) = figure(height=2.7)
    axes.plot(*thinned(time_s, measured), color=MEASURED, label="measured")
    axes.plot(*thinned(time_s, modelled), color=MODELLED, label=note)
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    axes.legend(loc="best", ncols=2)
    return made


def correlation(test: CorrelationTest, label: str) -> Figure:
    """Correlation by lag with its bounds, what lies outside in another colour."""
    made, (axes,) = figure(height=2.4)
    axes.axhspan(-test.bound, test.bound, color=NEUTRAL, alpha=0.25, linewidth=0)
    outside = np.abs(test.values) > test.bound
    for mask, color in ((~outside, GOOD), (outside, BAD)):
        axes.vlines(test.lags[mask], 0, test.values[mask], color=color, linewidth=2.2)
    axes.axhline(0, color=MEASURED, linewidth=0.7)
    axes.set_xlabel("input so many rows earlier")
    axes.set_ylabel(label)
    return made


def both_steps(time_s: Array, output: Array, label: str) -> Figure:
    """The answer to a lasting unit of u', one way and the other."""
    made, (axes,) = figure(height=2.4)
    axes.plot(time_s, output, color=SERIES[0], label="+1")
    axes.plot(time_s, -output, color=SERIES[1], label="-1")
    axes.axhline(0, color=NEUTRAL, linewidth=0.7)
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    axes.legend(loc="best")
    return made


def responses(panels: Mapping[str, Sequence[tuple[str, Array]]], period_s: float) -> Figure:
    """Step responses, one panel an axis, several lines in each; what diverges ends where it leaves
    the panel for good."""
    made, every = figure(height=2.8, columns=len(panels), sharey=True)
    for axes, (title, here) in zip(every, panels.items(), strict=True):
        for color, (label, y) in zip(SERIES, here, strict=False):
            lost = np.flatnonzero((y < LOST[0]) | (y > LOST[1]))
            shown = np.clip(y[: lost[0] + 1] if len(lost) else y, *LOST)
            axes.plot(period_s * np.arange(len(shown)), shown, color=color, label=label)
        axes.axhline(1.0, color=NEUTRAL, linewidth=0.8)
        axes.set_title(title)
        axes.set_xlim(0.0, period_s * max(len(y) for _, y in here))
        axes.set_ylim(-0.5, 2.5)
        axes.set_xlabel("s")
        axes.legend(loc="lower right")
    every[0].set_ylabel("response / step")
    return made
