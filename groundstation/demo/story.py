"""What is done, in order: each stage of the story and the commands it runs."""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path

from groundstation.demo.shell import Shell
from groundstation.errors import GroundStationError
from groundstation.extras import install

CRAFT = """# The software craft: exactly the physics of the base model, so that what will be hidden
# is all there is to find, and gains that carry it. Meaning of the keys: docs/stand_in.md.
[stand_in]
plant = "reduced"
program = "{program}"
seed = {seed}

[stand_in.gains]
"pid_rate.roll_kp" = 30.0
"pid_rate.pitch_kp" = 30.0
"pid_attitude.roll_kp" = 3.0
"pid_attitude.pitch_kp" = 3.0
"pid_attitude.roll_ki" = 3.0
"pid_attitude.pitch_ki" = 3.0
"""
ATTITUDE_FILTER = """
# Where the controller flies, the angles come from the firmware's own filter, as the design assumes.
[stand_in.effects.attitude_filter_lean]
strength = 1.0
"""
CRAFT_FILE, WAITING, FLIGHT, SEALED = "craft.toml", "waiting.toml", "flight.toml", "sealed.toml"
BENCH_S, FLIGHT_S = 40, 40
PID_FLIGHTS = ("pid_flight", "pid_flight_again")
READY_S = 90.0
"""A first start compiles the flight model."""
WITHOUT_CFLIB = (
    f"not flown: commanding a craft needs cflib (GPLv3), an optional extra: {install('radio')}"
)


class SkippedError(Exception):
    """The story goes on without this stage; why."""


@dataclass(frozen=True, slots=True)
class Stage:
    """name: for programs. title: for people. do: gets the shell and the seed."""

    name: str
    title: str
    do: Callable[[Shell, int], None]


@dataclass(slots=True)
class Told:
    """What the stages cost, by name: (wall s, processor s). skipped: why a stage was left out."""

    cost: dict[str, tuple[float, float]] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)


def inputs(seed: int) -> dict[str, str]:
    """The files that the story begins with."""
    return {
        CRAFT_FILE: CRAFT.format(program=FLIGHT, seed=100 * seed),
        WAITING: CRAFT.format(program="wait", seed=100 * seed + 9) + ATTITUDE_FILTER,
        FLIGHT: (files("groundstation.demo") / FLIGHT).read_text(encoding="utf-8"),
    }


def tell(shell: Shell, seed: int, begin: Callable[[int, Stage], None]) -> Told:
    """Every stage in order. begin: told each stage's number before it.

    Raises GroundStationError that names the stage where one fails.
    """
    told = Told()
    for number, stage in enumerate(STAGES):
        begin(number, stage)
        before = shell.spent
        try:
            stage.do(shell, seed)
        except SkippedError as reason:
            told.skipped[stage.name] = str(reason)
        except GroundStationError as error:
            raise GroundStationError(f"stage '{stage.title}': {error}") from error
        after = shell.spent
        told.cost[stage.name] = (
            round(after.wall_s - before.wall_s, 2),
            round(after.processor_s - before.processor_s, 2),
        )
    return told


def _motor(shell: Shell, seed: int) -> None:
    _fly(shell, "bench.csv", 100 * seed + 1, BENCH_S, "--program", "motor_bench")
    shell.run(
        "groundstation", "fit", "motor", "bench.csv", "-o", "motor.json", "--html", "motor.html"
    )


def _body(shell: Shell, seed: int) -> None:
    flights = ("flight1.csv", "flight2.csv")
    for number, name in enumerate(flights):
        _fly(shell, name, 100 * seed + 2 + number)
    fit = ("groundstation", "fit")
    motor = ("--model", "motor.json")
    shell.run(*fit, "body", *flights, *motor, "-o", "body.json", "--html", "body.html")
    shell.run(*fit, "arx", *flights, *motor, "--gyro", "-o", "arx.json", "--html", "arx.html")
    shell.run(
        *("groundstation", "simulate", "--model", "body.json", "--recording", "flight2.csv"),
        *("-o", "simulated.csv", "--html", "simulated.html"),
    )


def _controller(shell: Shell, seed: int) -> None:
    shell.run(
        *("groundstation", "pid", "design", "--model", "body.json", "-o", "gains.toml"),
        *("--html", "design.html", "--json"),
        into="design.json",
    )


def _controller_flies(shell: Shell, seed: int) -> None:
    """A second attempt where the first one was aborted: a busy machine falls behind real time."""
    if importlib.util.find_spec("cflib") is None:
        raise SkippedError(WITHOUT_CFLIB)
    for name in PID_FLIGHTS:
        try:
            _fly_gains(shell, name)
            break
        except GroundStationError as error:
            if "flight aborted" not in str(error):
                raise
            why = str(error).partition("flight aborted: ")[2].partition(";")[0]
            shell.remark(f"flown again, for the first flight was aborted: {why}")
    else:
        raise SkippedError(
            f"not flown to the end, twice ({why}); try again when the machine is less busy"
        )
    shell.run("groundstation", "convert", f"{name}/*.mcap", f"{name}.rrd")


def _fly_gains(shell: Shell, name: str) -> None:
    port = _free_udp_port()
    with shell.running(
        *("groundstation", "run", "--config", WAITING, "--command", f"udp://127.0.0.1:{port}"),
        *("--no-record", "--recordings", name, "--for", "240"),
    ) as daemon:
        _await_answer(shell, daemon)
        shell.run(
            *("groundstation", "pid", "fly", "--gains", "gains.toml", "--model", "body.json"),
            *("--repeat", "3", "--restore", "--html", f"{name}.html", "--json"),
            into=f"{name}.json",
        )


def _watched(shell: Shell, seed: int) -> None:
    shell.run(
        *("python", "-m", "firmware_sim.hide", "--settings", CRAFT_FILE),
        *("--seed", str(seed), "-o", SEALED),
    )
    shell.run(
        *("groundstation", "run", "--config", SEALED, "--twin", "body.json"),
        *("--for", str(FLIGHT_S + 1), "--recordings", "watched"),
    )
    only(shell.folder, "watched/*.mcap")
    shell.run("groundstation", "convert", "watched/*.mcap", "watched.rrd")


def _named(shell: Shell, seed: int) -> None:
    for number, name in enumerate(("hidden1.csv", "hidden2.csv")):
        _fly(shell, name, 100 * seed + 5 + number, settings=SEALED)
    shell.run(
        *("groundstation", "discrepancy", "watched/*.mcap", "hidden1.csv"),
        *("--validate", "hidden2.csv", "--model", "body.json", "-o", "improved.json"),
        *("--json", "found.json", "--html", "found.html", "--rerun", "found.rrd"),
    )


def _improved_flies(shell: Shell, seed: int) -> None:
    same = 100 * seed + 6  # as hidden2.csv: the same commands, the same noise
    _fly(shell, "as_body.csv", same, FLIGHT_S, "--craft", "body.json")
    _fly(shell, "as_improved.csv", same, FLIGHT_S, "--craft", "improved.json")


def _fly(
    shell: Shell,
    name: str,
    seed: int,
    seconds: int = FLIGHT_S,
    *more: str,
    settings: str = CRAFT_FILE,
) -> None:
    """A flight of the software craft in fast time."""
    shell.run(
        *("python", "-m", "firmware_sim", "--settings", settings, "--seed", str(seed), *more),
        *("--for", str(seconds), "--fast", "-o", name),
    )


def _await_answer(shell: Shell, daemon: subprocess.Popen[bytes]) -> None:
    from groundstation.service.client import ask

    deadline = time.monotonic() + READY_S
    while time.monotonic() < deadline:
        if daemon.poll() is not None:
            raise GroundStationError(shell.said(daemon))
        with contextlib.suppress(GroundStationError):
            if ask(shell.socket, "GET", "/status")["link"]["state"] == "streaming":
                return
        time.sleep(0.2)
    raise GroundStationError(
        f"no telemetry from the daemon after {READY_S:.0f} s; try when the machine is less busy"
    )


def only(folder: Path, pattern: str) -> Path:
    """A daemon's one recording. Raises GroundStationError where it made none, or began anew."""
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "nothing"
        raise GroundStationError(
            f"{pattern}: one recording was expected, there is {names}; try again when the machine"
            " is less busy and its disk not full"
        )
    return found[0]


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


STAGES = (
    Stage("motor", "A motor on the bench", _motor),
    Stage("body", "Two flights, and a model of the body", _body),
    Stage("controller", "A controller for that model", _controller),
    Stage("controller_flies", "The controller flies", _controller_flies),
    Stage("watched", "Something is wrong with the craft, and the twin watches", _watched),
    Stage("named", "What is it?", _named),
    Stage("improved_flies", "Does the improved model fly like the craft?", _improved_flies),
)
