"""``python -m bench.tipping``: a craft that tips back with its speed, in a simulator of its own.

A rigid body, motors, a battery, gusts, sensors and a cascade that hold nothing of the program's
code fly two flights to fit and one for the proof; speed is not recorded. A seed draws the moment,
gusts and noise. The search begins with ``fit body`` on the affected flights, and with nothing but
the vehicle's profile.
"""

from __future__ import annotations

import argparse
import json
import math
import random
from collections.abc import Iterator, Sequence
from pathlib import Path

from bench.command import run_command
from bench.results import Line, rows, run_cases

MASS_KG, ARM_M = 0.031, 0.0325
"""ARM_M: of a rotor along either axis."""
INERTIA = (1.7e-5, 1.75e-5, 3.0e-5)
THRUST_N, DRAG_N_M = 1.2e-6, 7.5e-9
"""Of a rotor at 1 rev/s; with the square of its speed."""
A0, A1, A2 = 2.5, 10.0, 0.04
"""Of a motor: dn/dt = A0 mV duty - A1 n - A2 n^2, n in rev/s."""
G = 9.80665
STEP_S, STEPS = 0.001, 2
"""A row every second step."""
SECONDS, FITTED = 30.0, 2
MOMENT, GUST, GUST_S = (8.0, 30.0), (2.0, 12.0), 0.05
"""rad/s^2 per m/s, either sign; rad/s^2 of air that changes within so long."""
GYRO_DEG_S, ACCELEROMETER_G, ANGLE_DEG = (0.05, 0.3), (0.004, 0.02), (0.02, 0.1)
THERE = {"velocity_moment", "inertia_coupling"}
"""What the simulator has beyond motors, mixer and a rigid body without Euler's coupling."""
SIDES = ((1, -1), (-1, -1), (-1, 1), (1, 1))
"""Of motors 1 to 4: ahead, left."""
TURNS = (-1, 1, -1, 1)
WITHIN, MOST_GAP = 1.96, 2.0
TITLES = ("case", "true moment", "found", "gap", "names", "search, s")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.tipping", description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, default=Path("build/bench-tipping"))
    chosen = parser.parse_args()
    folder = chosen.results
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "vehicle.toml").write_text(_profile())
    seeds = range(chosen.first, chosen.first + chosen.seeds)
    cases = [f"{start}-{seed}" for seed in seeds for start in ("fitted", "profile")]
    lines = run_cases(cases, folder, chosen.jobs, lambda case: _searched(case, folder), _cells)
    print("\n".join(_table(lines)))
    return 0


def _searched(case: str, folder: Path) -> Line:
    start, _, number = case.rpartition("-")
    seed = int(number)
    flights = [folder / f"{seed}-{flight}.csv" for flight in range(FITTED + 1)]
    moment = moment_of(seed)
    for flight, path in enumerate(flights):
        if not path.is_file():
            fly(path, seed, flight)
    vehicle, report = folder / "vehicle.toml", folder / f"{case}.json"
    report.unlink(missing_ok=True)
    line: Line = {"case": case, "moment": moment}
    base: list[object] = ["--vehicle", vehicle]
    if start == "fitted":
        model = folder / f"{case}.model.json"
        model.unlink(missing_ok=True)
        ended = run_command("fit", "body", *flights[:FITTED], *base, "-o", model)
        if ended.said:
            return line | {"error": ended.said}
        base = ["--model", model]
    given = [*flights[:FITTED], "--validate", flights[-1], *base, "--json", report]
    ended = run_command("discrepancy", *given)
    if ended.said:
        return line | {"error": ended.said}
    read = json.loads(report.read_text())
    found = {one["name"]: one["parameters"] for one in read["effects"]}
    size = found.get("velocity_moment", {}).get("moment")
    return line | {
        "verdict": read["verdict"],
        "names": list(found),
        "found": size and [size["value"], size["stderr"]],
        "gap": [read["gap"]["validation"][key] for key in ("before", "after")],
        "seconds": ended.seconds,
    }


def _within(line: Line) -> bool:
    size = line.get("found")
    return bool(size) and abs(size[0] - line["moment"]) <= WITHIN * size[1]


def _cells(line: Line) -> list[str]:
    if "error" in line:
        return [line["case"], f"{line['moment']:.2f}", line["error"], "", "", ""]
    size = line["found"]
    before, after = line["gap"]
    return [
        line["case"],
        f"{line['moment']:.2f}",
        "not named" if not size else f"{size[0]:.2f} ± {size[1]:.2f}",
        f"{before:.2f} → {after:.2f}",
        ", ".join(line["names"]),
        f"{line['seconds']:.0f}",
    ]


def _table(lines: Sequence[Line]) -> Iterator[str]:
    yield from rows(TITLES, lines, _cells)
    good = [line for line in lines if "error" not in line]
    of = len(lines)
    false = sum(bool(set(line["names"]) - THERE) for line in good)
    yield ""
    yield f"moment named: {sum(line['found'] is not None for line in good)} of {of}"
    yield f"within its 95 %: {sum(map(_within, good))} of {of}"
    yield f"gap at most {MOST_GAP:g}: {sum(line['gap'][1] <= MOST_GAP for line in good)} of {of}"
    yield f"with a false name: {false} of {of}"


# -- the simulator -------------------------------------------------------------------------------


def _profile() -> str:
    return f"""base = "crazyflie21"
name = "tipping"
mass_kg = {MASS_KG}
arm_m = {ARM_M * math.sqrt(2.0)}
inertia_kg_m2 = [{INERTIA[0]}, {INERTIA[1]}, {INERTIA[2]}]
thrust_n = {THRUST_N}
drag_n_m = {DRAG_N_M}
gyro_filter_hz = 0.0
accelerometer_filter_hz = 0.0
motor = {{ a0 = {A0}, a1 = {A1}, a2 = {A2} }}
"""


def moment_of(seed: int) -> float:
    draw = random.Random(seed)
    return draw.choice((-1.0, 1.0)) * draw.uniform(*MOMENT)


def fly(path: Path, seed: int, flight: int) -> None:
    """A flight as CSV in physical units. It begins in the air, at rest."""
    of_craft, draw = random.Random(seed + 10_000), random.Random(1000 * seed + flight)
    gust = of_craft.uniform(*GUST)
    gyro, force, angle = (
        of_craft.uniform(*one) for one in (GYRO_DEG_S, ACCELEROMETER_G, ANGLE_DEG)
    )
    moment = moment_of(seed)
    names = ["time_s", "battery_v", *(f"duty_{m}" for m in range(1, 5))]
    names += [f"gyro_{a}_deg_s" for a in "xyz"] + [f"accelerometer_{a}_g" for a in "xyz"]
    names += ["roll_deg", "pitch_deg", "yaw_deg"]
    craft, wanted = _Craft(moment), _Wanted(draw)
    lines = [",".join(names)]
    air = [0.0, 0.0, 0.0]
    keep = math.exp(-STEP_S / GUST_S)
    fresh = gust * math.sqrt(1.0 - keep**2)
    for row in range(round(SECONDS / (STEP_S * STEPS))):
        time_s = row * STEP_S * STEPS
        battery_v = 4.1 - 0.008 * time_s
        duty = craft.steered(wanted.at(time_s), battery_v)
        for _ in range(STEPS):
            air = [keep * one + fresh * draw.gauss(0.0, 1.0) for one in air]
            craft.step(duty, battery_v, air)
        turned = [math.degrees(one) + gyro * draw.gauss(0.0, 1.0) for one in craft.rates]
        felt = [one / G + force * draw.gauss(0.0, 1.0) for one in craft.felt]
        leant = [math.degrees(one) + angle * draw.gauss(0.0, 1.0) for one in craft.angles()]
        values = [time_s + STEP_S * STEPS, battery_v, *duty, *turned, *felt, *leant]
        lines.append(",".join(f"{value:.9g}" for value in values))
    path.write_text("\n".join(lines) + "\n")


class _Wanted:
    """Roll, pitch (rad), yaw rate (rad/s) and climb (m/s), each held 0.3 to 1.2 s."""

    SIZES = (0.2, 0.2, 1.5, 0.8)

    def __init__(self, draw: random.Random) -> None:
        self._draw, self._until = draw, [0.0] * 4
        self._now = [0.0] * 4

    def at(self, time_s: float) -> list[float]:
        for place, size in enumerate(self.SIZES):
            if time_s >= self._until[place]:
                self._until[place] = time_s + self._draw.uniform(0.3, 1.2)
                self._now[place] = size * self._draw.uniform(-1.0, 1.0)
        return self._now


class _Craft:
    """x ahead, y left, z up. Orientation is a matrix whose columns are the body's axes."""

    def __init__(self, moment: float) -> None:
        self._moment = moment
        self._place, self._speed = [0.0, 0.0, 20.0], [0.0, 0.0, 0.0]
        self._axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        self.rates, self.felt = [0.0, 0.0, 0.0], [0.0, 0.0, G]
        self._spin = [math.sqrt(MASS_KG * G / (4.0 * THRUST_N))] * 4

    def angles(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw, turned about z, y, x in that order."""
        m = self._axes
        pitch = math.asin(max(-1.0, min(1.0, -m[2][0])))
        return math.atan2(m[2][1], m[2][2]), pitch, math.atan2(m[1][0], m[0][0])

    def _in_body(self, vector: Sequence[float]) -> list[float]:
        m = self._axes
        return [sum(m[row][axis] * vector[row] for row in range(3)) for axis in range(3)]

    def steered(self, wanted: Sequence[float], battery_v: float) -> list[float]:
        """Duty of the four motors, from a cascade of proportional loops."""
        away = [-0.15 * p - 0.3 * v for p, v in zip(self._place, self._speed, strict=True)]
        home = self._in_body([away[0], away[1], 0.0])
        roll, pitch, _ = self.angles()
        lean_r = max(-0.5, min(0.5, wanted[0] - home[1]))
        lean_p = max(-0.5, min(0.5, wanted[1] + home[0]))
        asked = (6.0 * (lean_r - roll), 6.0 * (lean_p - pitch), wanted[2])
        gains = (20.0, 20.0, 8.0)
        torque = [
            inertia * gain * (rate - now)
            for inertia, gain, rate, now in zip(INERTIA, gains, asked, self.rates, strict=True)
        ]
        climb = 3.0 * (wanted[3] - 0.5 * (self._place[2] - 20.0) - self._speed[2])
        thrust = MASS_KG * (G + climb) / max(self._axes[2][2], 0.5)
        duty = []
        for (ahead, left), turns in zip(SIDES, TURNS, strict=True):
            force = thrust + left * torque[0] / ARM_M - ahead * torque[1] / ARM_M
            force = 0.25 * (force + turns * torque[2] * THRUST_N / DRAG_N_M)
            spin = math.sqrt(max(force, 1e-4) / THRUST_N)
            duty.append(max(0.05, min(1.0, (A1 * spin + A2 * spin**2) / (A0 * 1e3 * battery_v))))
        return duty

    def step(self, duty: Sequence[float], battery_v: float, air: Sequence[float]) -> None:
        """One step, each motion from the middle of the one below it."""
        before = self._spin
        self._spin = []
        for spin, share in zip(before, duty, strict=True):
            driven = A0 * 1e3 * battery_v * share
            half = spin + 0.5 * STEP_S * (driven - A1 * spin - A2 * spin**2)
            self._spin.append(spin + STEP_S * (driven - A1 * half - A2 * half**2))
        square = [(0.5 * (a + b)) ** 2 for a, b in zip(before, self._spin, strict=True)]
        thrust = THRUST_N * sum(square)
        torque = [
            THRUST_N * ARM_M * sum(left * n for (_, left), n in zip(SIDES, square, strict=True)),
            -THRUST_N * ARM_M * sum(ahead * n for (ahead, _), n in zip(SIDES, square, strict=True)),
            DRAG_N_M * sum(turns * n for turns, n in zip(TURNS, square, strict=True)),
        ]
        ahead, left, _ = self._in_body(self._speed)
        torque[0] += self._moment * left * INERTIA[0]
        torque[1] -= self._moment * ahead * INERTIA[1]
        p, q, r = self.rates
        x, y, z = INERTIA
        grown = [
            (torque[0] + (y - z) * q * r) / x + air[0],
            (torque[1] + (z - x) * p * r) / y + air[1],
            (torque[2] + (x - y) * p * q) / z + air[2],
        ]
        middle = [one + 0.5 * STEP_S * more for one, more in zip(self.rates, grown, strict=True)]
        self.rates = [one + STEP_S * more for one, more in zip(self.rates, grown, strict=True)]
        self._turn([STEP_S * one for one in middle])
        push = thrust / MASS_KG
        self.felt = [0.0, 0.0, THRUST_N * sum(n**2 for n in self._spin) / MASS_KG]
        up = [row[2] for row in self._axes]
        before_m_s = self._speed
        self._speed = [v + STEP_S * push * one for v, one in zip(before_m_s, up, strict=True)]
        self._speed[2] -= STEP_S * G
        self._place = [
            p + 0.5 * STEP_S * (a + b)
            for p, a, b in zip(self._place, before_m_s, self._speed, strict=True)
        ]

    def _turn(self, angle: Sequence[float]) -> None:
        """Rodrigues' rotation about body axes."""
        size = math.sqrt(sum(one**2 for one in angle))
        if size < 1e-12:
            return
        x, y, z = (one / size for one in angle)
        s, c = math.sin(size), 1.0 - math.cos(size)
        turn = (
            (1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y),
            (c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x),
            (c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)),
        )
        self._axes = [
            [sum(row[k] * turn[k][axis] for k in range(3)) for axis in range(3)]
            for row in self._axes
        ]


if __name__ == "__main__":
    raise SystemExit(main())
