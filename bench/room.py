"""``python -m bench.room``: whether the flights of ``learn`` stay in their room.

Crafts by a seed, half of them Brushless, with a mass, motors, a weak rotor and a tilted IMU of
their own, behind a real daemon: the flights without the computing between them, measured on what
the craft really did.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from bench.daemon import busy, run_daemon, until_status
from bench.results import Line, rows, run_cases
from groundstation.errors import GroundStationError
from groundstation.service.client import ask

HEIGHT_M, REACH_M = 0.5, 1.0
BEYOND_M, ASIDE_M_S, DOWN_M_S = 0.6, 0.3, 0.6
"""What is asked for: within the reach and so much more, and no faster at a touch-down."""
MASS_PERCENT, WEAK, TURNED_DEG, BRAKES = (-10.0, 20.0), 0.1, 1.5, (0.65, 1.0)
"""Ranges that a seed draws from: mass, how much one rotor lacks, how far the IMU is turned about
each axis, how fast motors brake against how they accelerate."""
GAINS = (0.8, 1.3)
"""Of the stock gains, for the flight with new ones."""
PLANNED_S = 45.0
FLIGHTS = ("hover", "body", "planned", "proof", "before", "after")
AIR_M, FLOOR_M, BEFORE_S = 0.05, 0.01, 0.1
"""Above the first a craft flies, below the second it has touched down, with the fastest that it was
in so long before."""
LANDED_S = 6.0
"""A Brushless disarms itself until so long after a landing, also one that was armed again."""
TICK_S, MOST_S = 0.01, 0.05
RESULT = "room: "
TITLES = ("craft", "mass, %", "weak rotor, %", "IMU, deg", "flights", "farthest, m", "top, m/s",
          "aside, m/s", "down, m/s", "cut short")  # fmt: skip


def main() -> int:
    options = _options()
    if options.only:
        fly_case(options.only, options.flights)
        return 0
    crafts = ("crazyflie21", "brushless")
    cases = [f"{crafts[n % 2]}-{options.seed + n // 2}" for n in range(options.crafts)]
    with busy(options.busy * (os.cpu_count() or 1)):
        lines = run_cases(
            cases,
            options.results,
            min(options.jobs, 2),
            lambda case: _in_its_process(case, options),
            _cells,
        )
    print("\n".join(table(lines)))
    return int(not all(kept(line) for line in lines))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench.room", description=__doc__)
    parser.add_argument("--crafts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1, help="of the first two")
    parser.add_argument("--jobs", type=int, default=1, help="at the same time, two at most")
    parser.add_argument(
        "--busy", type=int, default=0, metavar="N", help="processes that spin, a core"
    )
    parser.add_argument("--flights", nargs="+", choices=FLIGHTS, default=list(FLIGHTS))
    parser.add_argument("--results", type=Path, default=Path("room-results"))
    parser.add_argument("--only", default="", help=argparse.SUPPRESS)
    return parser.parse_args()


def _in_its_process(case: str, options: argparse.Namespace) -> Line:
    ended = subprocess.run(
        [sys.executable, "-m", "bench.room", "--only", case, "--flights", *options.flights],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    for text in ended.stdout.splitlines():
        if text.startswith(RESULT):
            return dict(json.loads(text.removeprefix(RESULT)))
    return {"case": case, "error": ended.stderr.strip().rpartition("\n")[2]}


# -- one craft ---------------------------------------------------------------------------------


def drawn(case: str) -> dict[str, dict[str, float]]:
    """What is wrong with a craft: effects of the software craft."""
    craft, _, seed = case.rpartition("-")
    random = np.random.default_rng([int(seed), craft == "brushless"])
    turned = [random.uniform(-TURNED_DEG, TURNED_DEG) for _ in range(2)]
    return {
        "mass_change": {"percent": random.uniform(*MASS_PERCENT)},
        "rotor_mismatch": {"rotor": float(random.integers(1, 5)),
                           "excess": -random.uniform(0.0, WEAK)},
        "imu_misalignment": {"roll_deg": turned[0], "pitch_deg": turned[1], "yaw_deg": 0.0},
        "motor_braking_asymmetry": {"factor": random.uniform(*BRAKES)},
    }  # fmt: skip


def fly_case(case: str, flights: Sequence[str]) -> None:
    """Print every flight of one craft and what it really did in each, however its daemon ends."""
    craft, _, seed = case.rpartition("-")
    effects = drawn(case)
    line: Line = {"case": case, "effects": effects, "flights": {}}
    settings = {"plant": "faithful", "craft": craft, "flow_deck": True, "program": "wait",
                "resume_s": 1e6, "seed": int(seed), "effects": effects}  # fmt: skip
    with (
        tempfile.TemporaryDirectory(prefix="room-") as name,
        _flown(settings) as (uri, truth),
        run_daemon(Path(name), "--link", uri, "--viewer", "off") as control,
    ):
        os.environ["GROUNDSTATION_SOCKET"] = str(control)
        for flight in flights:
            line["flights"][flight] = _one(flight, int(seed), Path(name), control, truth)
        print(RESULT + json.dumps(line), flush=True)


def _one(flight: str, seed: int, folder: Path, control: Path, truth: Connection) -> dict[str, Any]:
    from groundstation.cli.flying import stops_begun
    from groundstation.cli.learn import DaemonPlace

    try:
        until_status(control, _connected)  # a busy machine may lose it between two flights
        if "brushless" in str(ask(control, "GET", "/status")["vehicle"]).lower():
            time.sleep(LANDED_S)
            ask(control, "POST", "/command/arm", {"on": True})
        gains = _changed(control, seed) if flight == "after" else {}
        place = DaemonPlace(HEIGHT_M, REACH_M, stops_begun(control), told=lambda text: None)
        flown = place.fly(_plan(flight, seed), folder / f"{flight}.mcap", seed=seed, gains=gains)
        aborted = flown.aborted
    except GroundStationError as error:
        aborted = str(error)
    truth.send("told")
    return {"aborted": aborted, "truth": truth.recv()}


def _changed(control: Path, seed: int) -> dict[str, float]:
    """Gains of the attitude's and the rate's loops, as a design might change them."""
    present = ask(control, "GET", "/command/parameters")["values"]
    random = np.random.default_rng(seed)
    return {
        name: value * random.uniform(*GAINS)
        for name, value in present.items()
        if value and name.startswith(("pid_attitude", "pid_rate")) and name.endswith(("kp", "kd"))
    }


def _plan(flight: str, seed: int) -> Any:
    """The same that ``learn`` flies; of what it would plan, manoeuvres at random."""
    from groundstation.learn.planning import BODY, HOVER, PROOF, REST_S, Limits, flight_of, library
    from groundstation.learn.story import step_flight

    limits = Limits(reach_m=REACH_M, height_m=HEIGHT_M)
    if flight in ("before", "after"):
        return step_flight(limits)
    names = {"hover": HOVER, "body": BODY, "proof": PROOF}.get(flight)
    if names is None:
        known = library(limits, seed)
        order = np.random.default_rng(seed).permutation(list(known))
        seconds = np.cumsum([known[one].seconds + REST_S for one in order])
        names = tuple(order[seconds <= PLANNED_S])
    return flight_of(names, flight, limits, seed)


def _connected(status: dict[str, Any]) -> bool:
    up = status["command"] is not None and status["command"]["state"] == "connected"
    return up and status["link"]["state"] == "streaming"


# -- the craft, in a process of its own --------------------------------------------------------


@contextlib.contextmanager
def _flown(settings: dict[str, Any]) -> Iterator[tuple[str, Connection]]:
    """A craft in real time: its address, and who tells its truth."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(settings, there), daemon=True)
    process.start()
    try:
        yield here.recv(), here
    finally:
        process.terminate()
        process.join(10.0)


def _serve(settings: dict[str, Any], truth: Connection) -> None:
    from firmware_sim.craft import StandIn
    from firmware_sim.crtp import CrtpServer
    from firmware_sim.settings import StandInSettings

    async def serve() -> None:
        craft, watch = StandIn(StandInSettings(**settings)), _Watch()
        craft.advance(3.0)
        server = CrtpServer(craft, port=0)
        await server.start()
        truth.send(f"udp://127.0.0.1:{server.port}")
        flown_s = craft.time_s
        ahead_s = flown_s - time.monotonic()
        while True:
            await asyncio.sleep(TICK_S * 0.9)
            late_s = time.monotonic() + ahead_s - flown_s
            flown_s += min(max(late_s, TICK_S), MOST_S)
            craft.advance(flown_s)
            watch.look(craft.state())
            if truth.poll():
                truth.recv()
                truth.send(watch.told())

    asyncio.run(serve())


class _Watch:
    """What a craft really does, since the last was told: farthest from the place of its take-off,
    fastest, and the hardest touch-down."""

    def __init__(self) -> None:
        self._home = (0.0, 0.0)
        self._begin()
        self._before: list[tuple[float, float, float]] = []

    def _begin(self) -> None:
        self._air = False
        self._said = dict.fromkeys(
            ("farthest_m", "highest_m", "top_m_s", "aside_m_s", "down_m_s", "touched"), 0.0
        )

    def look(self, state: Any) -> None:
        x, y, z = state.position_m
        ahead, left, up = state.velocity_m_s
        if not self._air and not any(state.motors):
            self._home = x, y
            return
        speed = math.hypot(ahead, left)
        self._before = [one for one in self._before if state.time_s - one[0] <= BEFORE_S]
        self._before.append((state.time_s, speed, -up))
        self._most(farthest_m=math.hypot(x - self._home[0], y - self._home[1]))
        self._most(highest_m=z, top_m_s=speed)
        if self._air and z < FLOOR_M:
            _, aside, down = max(self._before, key=lambda one: one[2])
            self._most(aside_m_s=aside, down_m_s=down)
            self._said["touched"] += 1.0
        self._air = z > (FLOOR_M if self._air else AIR_M)

    def told(self) -> dict[str, float]:
        said = self._said
        self._begin()
        return said

    def _most(self, **values: float) -> None:
        for name, value in values.items():
            self._said[name] = max(self._said[name], value)


# -- what came of it ---------------------------------------------------------------------------


def kept(line: Line) -> bool:
    """Whether every flight stayed in its room and touched down gently."""
    return "error" not in line and all(
        one["truth"]["farthest_m"] <= REACH_M + BEYOND_M
        and one["truth"]["aside_m_s"] <= ASIDE_M_S
        and one["truth"]["down_m_s"] <= DOWN_M_S
        for one in line["flights"].values()
    )


def table(lines: Sequence[Line]) -> Iterator[str]:
    """A row a craft, and the acceptance."""
    yield from rows(TITLES, lines, _cells)
    good = [line for line in lines if "error" not in line]
    flights = [one for line in good for one in line["flights"].values()]
    most = {name: max((one["truth"][name] for one in flights), default=math.nan)
            for name in ("farthest_m", "aside_m_s", "down_m_s")}  # fmt: skip
    yield ""
    yield f"crafts that kept to it: {sum(map(kept, lines))} of {len(lines)}"
    yield f"flights: {len(flights)}, cut short: {sum(bool(one['aborted']) for one in flights)}"
    yield f"farthest: {most['farthest_m']:.2f} m of {REACH_M + BEYOND_M:g} m"
    yield f"fastest sideways at a touch-down: {most['aside_m_s']:.2f} m/s of {ASIDE_M_S:g} m/s"
    yield f"fastest down at a touch-down: {most['down_m_s']:.2f} m/s of {DOWN_M_S:g} m/s"
    dropped = sum(one["truth"]["down_m_s"] > DOWN_M_S for one in flights)
    yield f"dropped: {dropped} of {len(flights)} flights"


def _cells(line: Line) -> list[str]:
    if "error" in line:
        return [line["case"], line["error"], *[""] * (len(TITLES) - 2)]
    effects, flights = line["effects"], line["flights"].values()
    most = {name: max((one["truth"][name] for one in flights), default=math.nan)
            for name in ("farthest_m", "top_m_s", "aside_m_s", "down_m_s")}  # fmt: skip
    turned = effects["imu_misalignment"]
    return [
        line["case"],
        f"{effects['mass_change']['percent']:+.0f}",
        f"{-100.0 * effects['rotor_mismatch']['excess']:.0f}",
        f"{math.hypot(turned['roll_deg'], turned['pitch_deg']):.1f}",
        str(len(flights)),
        *(f"{value:.2f}" for value in most.values()),
        "; ".join(f"{name}: {one['aborted']}" for name, one in line["flights"].items()
                  if one["aborted"]),
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
