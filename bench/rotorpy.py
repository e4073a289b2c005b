"""``python -m bench.rotorpy [CASE...]``: the physics of a simulator that nobody here wrote.

RotorPy 3.0 (Folk, Paulos, Kumar 2023, MIT) flies its own Crazyflie parameters: rigid body with
full Euler coupling, first-order motors, rotor drag, inflow and flapping at each hub. A model is
fitted to its flights without aerodynamics; then ``discrepancy`` searches flights with one
coefficient after another, and each size found stands beside what RotorPy's own source computes
from its parameters.

Needs the extra: ``pip install -e '.[rotorpy]'``. Flights and reports are kept in ``--results``.
"""

from __future__ import annotations

import argparse
import math
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.command import run_command
from bench.real.program import find

Array = NDArray[np.float64]

PERIOD_S, SECONDS = 0.002, 25.0
BATTERY_V = 4.0
FRONT_RIGHT_FIRST = (1, 2, 3, 0)
"""RotorPy's rotors in the order M1 front right, M2 rear right, M3 rear left, M4 front left."""
FLAP_NM = -2.0
"""Wanted moment against velocity, rad/s^2 per m/s."""
CASES: dict[str, dict[str, Any]] = {
    "rigid body": {"aero": False},
    "k_z": {"k_d": 0.0},
    "k_d": {"k_z": 0.0},
    "k_flap": {"k_d": 0.0, "k_z": 0.0, "k_flap": 0.0},
    "10 ms": {"aero": False, "late_rows": 5},
    "IMU 10 mm forward": {"aero": False, "imu_m": (0.01, 0.0, 0.0)},
}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.rotorpy", description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}")
    parser.add_argument("--results", type=Path, default=Path("build/bench-rotorpy"))
    chosen = parser.parse_args()
    if wrong := [case for case in chosen.cases if case not in CASES]:
        parser.error(f"{', '.join(wrong)} not known; there are {', '.join(CASES)}")
    folder = chosen.results
    folder.mkdir(parents=True, exist_ok=True)
    model = base_model(folder)
    print("| hidden in RotorPy | effect | its source computes | found | apart | gap |")
    print("|---|---|---|---|---|---|")
    for case in chosen.cases or CASES:
        for line in searched(case, model, folder):
            print(line, flush=True)
    return 0


def base_model(folder: Path) -> str:
    """``fit body`` on two flights of the rigid body."""
    model, vehicle = folder / "base.json", folder / "vehicle.toml"
    if not model.is_file():
        vehicle.write_text(_profile())
        flights = [str(flown("rigid body", seed, folder)) for seed in (1, 2)]
        ended = run_command("fit", "body", *flights, f"--vehicle={vehicle}", "-o", model)
        if ended.said:
            raise SystemExit(ended.said)
    return str(model)


def searched(case: str, model: str, folder: Path) -> Iterator[str]:
    flights = [flown(case, seed, folder) for seed in (3, 4, 5)]
    report = folder / f"{case.replace(' ', '_')}.json"
    found = find(flights[:2], flights[2:], model, report)
    if "refused" in found:
        yield f"| {case} | refused: {found['refused']} | | | | |"
        return
    gap = f"{found['gap']['before']:.2f} -> {found['gap']['after']:.2f}"
    known = expected(case, flights[2])
    for name, parameters in found["effects"].items():
        for key, one in parameters.items():
            truth = known.pop((name, key), None)
            error = "" if one["stderr"] is None else f" +- {one['stderr']:.1g}"
            size = f"{one['value']:.4g}{error} {one['unit']}"
            apart = "" if truth is None else f"{100 * (one['value'] / truth - 1):+.1f} %"
            told = "nothing" if truth is None else f"{truth:.4g}"
            yield f"| {case} | {name} | {told} | {size} | {apart} | {gap} |"
    for (name, _), truth in known.items():
        yield f"| {case} | {name} | {truth:.4g} | not named | | {gap} |"


def expected(case: str, flight: Path) -> dict[tuple[str, str], float]:
    """(effect, parameter) -> what RotorPy's source makes of its coefficients at this flight."""
    p = parameters(case)
    spin = float(flight.with_suffix(".speed").read_text())
    reach = p["rotor_pos"]["r1"][0]
    known = {("inertia_coupling", "fraction"): 1.0}
    if p["aero"]:
        if p["k_z"]:
            known["rate_damping", "damping_n_m_s"] = p["k_z"] * spin * reach**2
            known["climb_inflow", "loss_g_per_m_s"] = p["k_z"] * spin / (p["mass"] * 9.80665)
        if p["k_d"]:
            known["rotor_drag", "drag_n_s_m"] = p["k_d"] * spin
            known["yaw_damping", "damping_n_m_s"] = p["k_d"] * spin * 2 * reach**2
        if p["k_flap"]:
            known["velocity_moment", "moment"] = -p["k_flap"] * spin / p["Ixx"]
    if p["late_rows"]:
        known["dead_time", "delay_s"] = p["late_rows"] * PERIOD_S
    return known


def parameters(case: str) -> dict[str, Any]:
    """RotorPy's Crazyflie, with what the case changes."""
    from rotorpy.vehicles.crazyflie_params import quad_params

    p = {**quad_params, "aero": True, "late_rows": 0, "imu_m": (0.0, 0.0, 0.0), **CASES[case]}
    if case == "k_flap":
        p["k_flap"] = -FLAP_NM * p["Ixx"] / (4 * _hover_rad_s(p))
    return p


def _hover_rad_s(p: dict[str, Any]) -> float:
    return math.sqrt(p["mass"] * 9.81 / (4 * p["k_eta"]))


def _profile() -> str:
    """The vehicle as its parameters say; a first-order motor is a2 = 0."""
    p = parameters("rigid body")
    full = p["rotor_speed_max"] / math.tau
    turn = math.tau**2
    return f"""base = "crazyflie21"
name = "rotorpy_crazyflie"
mass_kg = {p["mass"]}
arm_m = 0.043
inertia_kg_m2 = [{p["Ixx"]}, {p["Iyy"]}, {p["Izz"]}]
thrust_n = {p["k_eta"] * turn}
drag_n_m = {p["k_m"] * turn}
gyro_filter_hz = 0.0
accelerometer_filter_hz = 0.0
motor = {{ a0 = {full / p["tau_m"] / (1e3 * BATTERY_V)}, a1 = {1 / p["tau_m"]}, a2 = 0.0 }}
"""


def flown(case: str, seed: int, folder: Path) -> Path:
    """A flight as CSV in physical units, made once; beside it the mean sum of rotor speeds."""
    path = folder / f"{case.replace(' ', '_')}_{seed}.csv"
    if path.is_file():
        return path
    rows, spin = _fly(parameters(case), np.random.default_rng(seed))
    names = ["time_s", "battery_v", *(f"duty_{m}" for m in range(1, 5))]
    names += [f"gyro_{a}_deg_s" for a in "xyz"] + [f"accelerometer_{a}_g" for a in "xyz"]
    names += ["roll_deg", "pitch_deg", "yaw_deg"]
    path.with_suffix(".speed").write_text(f"{spin}\n")
    np.savetxt(path, rows, "%.9g", ",", header=",".join(names), comments="")
    return path


def _fly(p: dict[str, Any], rng: np.random.Generator) -> tuple[Array, float]:
    """Rows of telemetry under a plain cascade of ours, and the mean sum of rotor speeds (rad/s).

    Angles swing at random about those that bring the craft back, yaw rate and height likewise.
    """
    from rotorpy.sensors.imu import Imu
    from rotorpy.vehicles.multirotor import Multirotor
    from scipy.spatial.transform import Rotation

    hover = _hover_rad_s(p)
    start = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}
    start |= {"q": np.array([0.0, 0.0, 0.0, 1.0]), "rotor_speeds": np.full(4, hover)}
    # one step of third order per row where its error estimate allows: half the default's time
    solver = {"method": "RK23", "first_step": PERIOD_S, "rtol": 1e-6, "atol": 1e-8}
    craft = Multirotor(p, start, aero=p["aero"], integrator_kwargs=solver)
    np.random.seed(rng.integers(2**31))  # RotorPy's IMU draws from the global generator
    imu = Imu(p_BS=np.array(p["imu_m"]))
    count = round(SECONDS / PERIOD_S)
    wanted = _programme(count, rng)
    late = deque([np.full(4, hover)] * p["late_rows"])
    state, rows, spin = start, np.empty((count, 15)), 0.0
    command = np.full(4, hover)
    for row in range(count):
        late.append(command)
        acting = late.popleft()
        state = craft.step(state, {"cmd_motor_speeds": acting}, PERIOD_S)
        slopes = craft.statedot(state, {"cmd_motor_speeds": acting}, PERIOD_S)
        felt = imu.measurement(state, slopes)
        turn = Rotation.from_quat(state["q"])
        yaw, pitch, roll = turn.as_euler("ZYX")
        angles = np.array([roll, pitch, yaw]) + math.radians(0.02) * rng.standard_normal(3)
        duty = command[list(FRONT_RIGHT_FIRST)] / p["rotor_speed_max"]
        rows[row, :2] = (row + 1) * PERIOD_S, BATTERY_V
        rows[row, 2:6] = duty
        rows[row, 6:9] = np.degrees(felt["gyro"])
        rows[row, 9:12] = felt["accel"] / 9.80665
        rows[row, 12:] = np.degrees(angles)
        spin += float(state["rotor_speeds"].sum()) / count
        command = _control(craft, state, turn, angles, felt["gyro"], wanted[row])
    return rows, spin


def _programme(count: int, rng: np.random.Generator) -> Array:
    """Roll, pitch (rad), yaw rate (rad/s), climb (m/s), each held 0.3 to 1.2 s: (count, 4)."""
    sizes = (math.radians(12), math.radians(12), 1.5, 1.0)
    out = np.empty((count, 4))
    for column, size in enumerate(sizes):
        row = 0
        while row < count:
            last = row + round(rng.uniform(0.3, 1.2) / PERIOD_S)
            out[row:last, column] = size * rng.uniform(-1, 1)
            row = last
    return out


def _control(
    craft: Any, state: dict[str, Array], turn: Any, angles: Array, gyro: Array, wanted: Array
) -> Array:
    """Rotor speeds (4,) in rad/s of a cascade of proportional loops."""
    home = turn.inv().apply(-0.15 * state["x"] - 0.25 * state["v"])
    tilt = np.clip([wanted[0] - home[1], wanted[1] + home[0]], -0.5, 0.5)
    rates = np.array([6.0 * (tilt[0] - angles[0]), 6.0 * (tilt[1] - angles[1]), wanted[2]])
    moment = craft.inertia @ (np.array([18.0, 18.0, 8.0]) * (rates - gyro))
    climb = 3.0 * (wanted[3] - 0.5 * state["x"][2] - state["v"][2])
    thrust = craft.mass * (9.81 + climb) / max(float(turn.as_matrix()[2, 2]), 0.5)
    forces = np.maximum(craft.TM_to_f @ np.concatenate([[thrust], moment]), 1e-4)
    return np.asarray(np.clip(np.sqrt(forces / craft.k_eta), 300.0, craft.rotor_speed_max))


if __name__ == "__main__":
    raise SystemExit(main())
