"""Flights, bench runs, models: each made by a command that anybody can type, when first needed."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from importlib.resources import files
from typing import Any, TypeVar

from groundstation.control.firmware_loop import gains_text
from groundstation.control.linear_loop import GAINS
from groundstation.dynamics.model import Model, load_model
from groundstation.identification.runs import Run, runs_of
from groundstation.recording.formats import open_recording
from groundstation.shell import Shell
from groundstation.telemetry.samples import SampleBatch

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
        """(the commands that made what was used since ``begin``, those and all that they need;
        both in the order in which they make it from nothing)."""
        direct = [line for name, line in RECIPES.items() if name in self._used]
        found: list[str] = []
        for name in self._used:
            found += [line for line in chain(name) if line not in found]
        return direct, found

    def use(self, name: str) -> str:
        """Make sure that a file is there; its full path."""
        if name not in self._used:
            self._used.append(name)
        self._provide(name)
        return str(self._shell.folder / name)

    def _provide(self, name: str) -> None:
        if (self._shell.folder / name).exists():
            return
        for needed in _needs(name):
            self._provide(needed)
        words = shlex.split(RECIPES[name])
        if ">" in words:
            self._shell.run(*words[: words.index(">")], into=words[-1])
        else:
            self._shell.run(*words)

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
        path = self.use(name)

        def read() -> Any:
            with open(path, encoding="utf-8") as file:
                return json.load(file)

        return self.once(("said", name), read)

    def once(self, key: Any, make: Callable[[], Value]) -> Value:
        """What was made under this key before, or makes it."""
        if key not in self._kept:
            self._kept[key] = make()
        found: Value = self._kept[key]
        return found


def chain(name: str) -> list[str]:
    """The commands that make a file from nothing, in order."""
    found: list[str] = []
    for needed in _needs(name):
        found += [line for line in chain(needed) if line not in found]
    return [*found, RECIPES[name]] if name in RECIPES else found


def _needs(name: str) -> list[str]:
    words = shlex.split(RECIPES.get(name, ""))
    return [word for word in words if word in RECIPES and word != name]
