"""``python -m bench.drawn``: crafts of today's firmware that a seed makes, learnt whole.

Half are Brushless. Each has a mass, motors, rotors, a centre of gravity, a weak rotor, an IMU that
is turned, a drag and a release of its own, flown by ``learn`` on the faithful software craft in
fast time, which gives them the rest of what every craft has. A folder a craft: one that was begun
is gone on with.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from bench.learn import COMMAND
from bench.results import Line, rows, run_cases
from firmware_sim.physics import present_effects
from firmware_sim.releases import PROTOCOLS_OF
from firmware_sim.settings import parse_settings
from groundstation.control.step_analysis import Flown
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import BUILT_IN, MotorConstants, Vehicle
from groundstation.learn.planning import journal_in
from groundstation.learn.report import outcome_of
from groundstation.learn.story import axis_of, missed, named_effects, read_found

CRAFTS = ("crazyflie21", "brushless")
MASS, INERTIA, MOTOR, THRUST = (0.9, 1.2), (0.9, 1.15), (0.92, 1.08), (0.93, 1.07)
ROTOR_KG_M2, OFF_M, WEAK, TURNED_DEG = (1.5e-8, 6.0e-8), 3e-3, (0.03, 0.1), (1.0, 7.0)
DRAG_PER_S, BRAKES = (0.15, 0.45), (0.6, 0.9)
"""Ranges that a seed draws from; the first four over the profile's."""
CONSTANTS = ("c0", "c1", "c2")
"""Each over thrust_per_mass: what the torques do while the craft is carried. Volts, sag and the
motors' speeds, which nothing measures, cancel."""
CONSTANTS_WITHIN, OVERSHOOT_WITHIN, SEARCH_S, SIGMAS = 0.05, 0.05, 120.0, 1.96
TITLES = ("craft", "release", "constants, %", "names", "sizes", "gap", "search, s",
          "gains", "RMS", "overshoot, points: most off")  # fmt: skip


def main() -> int:
    options = _options()
    seeds = range(options.first, options.first + (options.crafts + 1) // 2)
    cases = [f"{craft}-{seed}" for seed in seeds for craft in CRAFTS][: options.crafts]
    results = options.results
    lines = run_cases(cases, results, options.jobs, lambda case: learn(case, results), _cells)
    print("\n".join(table(lines)))
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench.drawn", description=__doc__)
    parser.add_argument("--crafts", type=int, default=20)
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="where seeds begin")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, default=Path("drawn-results"))
    return parser.parse_args()


def drawn(case: str) -> tuple[Vehicle, dict[str, Any]]:
    """The craft of a case, and the software craft's settings beside it."""
    name, _, seed = case.rpartition("-")
    stock = BUILT_IN[name]
    random = np.random.default_rng([int(seed), name == "brushless", 68])
    mass, inertia, thrust = (random.uniform(*span) for span in (MASS, INERTIA, THRUST))
    motor = stock.motor
    craft = msgspec.structs.replace(
        stock,
        mass_kg=stock.mass_kg * mass,
        inertia_kg_m2=tuple(one * inertia for one in stock.inertia_kg_m2),
        motor=MotorConstants(motor.a0 * random.uniform(*MOTOR), motor.a1 * random.uniform(*MOTOR),
                             motor.a2),
        thrust_n=stock.thrust_n * thrust,
        drag_n_m=stock.drag_n_m * thrust,
        rotor_inertia_kg_m2=random.uniform(*ROTOR_KG_M2),
    )  # fmt: skip
    angle, off = random.uniform(0.0, 2.0 * math.pi), OFF_M * math.sqrt(random.uniform(0.05, 1.0))
    turned = random.normal(size=3)
    turned *= random.uniform(*TURNED_DEG) / np.linalg.norm(turned)
    effects = {
        "centre_of_gravity_offset": {"x_m": off * math.cos(angle), "y_m": off * math.sin(angle)},
        "rotor_mismatch": {"rotor": float(random.integers(1, 5)),
                           "excess": -random.uniform(*WEAK)},
        "imu_misalignment": dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), turned.tolist(),
                                     strict=True)),
        "rotor_drag": {"drag_n_s_m": random.uniform(*DRAG_PER_S) * craft.mass_kg},
    }  # fmt: skip
    if name != "brushless":  # whose motors are braked
        effects["motor_braking_asymmetry"] = {"factor": random.uniform(*BRAKES)}
    release = str(random.choice(sorted(PROTOCOLS_OF)))
    return craft, {"plant": "faithful", "flow_deck": True, "seed": int(seed), "release": release,
                   "effects": effects}  # fmt: skip


def learn(case: str, results: Path) -> Line:
    """Learn one craft and hold what came of it against what it is."""
    folder, vehicle, settings = (results / f"{case}{end}" for end in ("", ".vehicle.toml", ".toml"))
    craft, given = drawn(case)
    vehicle.write_text(_toml(msgspec.to_builtins(craft)))
    text = _toml({**given, "craft": str(vehicle.absolute())})
    settings.write_text(text)
    ended = subprocess.run(
        [COMMAND, "learn", "--link", f"software:{settings}", "--yes", "--json", "-o", str(folder)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    try:
        return {"case": case, "release": given["release"], **_judged(craft, text.encode(), folder)}
    except Exception as error:
        said = ended.stderr.strip().rpartition("\n")[2]
        return {"case": case, "error": said or f"{type(error).__name__}: {error}"}


def _toml(values: dict[str, Any], table: str = "") -> str:
    """JSON writes a number, a text, a truth and a list as TOML does."""
    own = {key: value for key, value in values.items() if not isinstance(value, dict)}
    lines = [f"[{table}]"] * bool(table) + [f"{k} = {json.dumps(v)}" for k, v in own.items()]
    more = [_toml(value, f"{table}.{key}".lstrip("."))
            for key, value in values.items() if key not in own]  # fmt: skip
    return "\n".join([*lines, "", *more])


def _judged(craft: Vehicle, settings: bytes, folder: Path) -> Line:
    journal = journal_in(folder)
    assert journal is not None
    outcome = outcome_of(journal, folder)
    body = outcome.model.body
    assert body is not None
    truth = present_effects(parse_settings(settings))
    hidden = set(parse_settings(settings).effects) | {"rotor_acceleration_torque"}
    found = read_found(folder / f"{outcome.found_name}.json")
    every = {one.name: one.parameters for one in found.effects}
    named = {one.name for one in named_effects(found)} & {*every}
    carried = craft.thrust_per_mass / body.thrust_per_mass
    true = dict(zip(CONSTANTS, craft.body_constants, strict=True))
    sizes = [
        abs(one.value - truth[name][key]) <= SIGMAS * one.stderr
        for name, parameters in every.items()
        if name in truth
        for key, one in parameters.items()
        if one.stderr is not None and key in truth[name]
    ]
    seconds = re.findall(r"discrepancy.*?\n# ([0-9.]+) s of", (folder / "log.txt").read_text(),
                         re.DOTALL)  # fmt: skip
    return {
        "constants": {key: carried * getattr(body, key) / value - 1.0
                      for key, value in true.items()},
        "missed": sorted(hidden - {*every}),
        "false": sorted(name for name in named - {*truth} if EFFECTS[name].renames is None),
        "found": {name: {key: [one.value, one.stderr, truth.get(name, {}).get(key)]
                         for key, one in parameters.items()} for name, parameters in every.items()},
        "hidden": len(hidden),
        "sizes": [sum(sizes), len(sizes)],
        "gap": [found.gap.validation.before, found.gap.validation.after],
        "verdict": found.verdict,
        "search_s": max(map(float, seconds), default=math.nan),
        "gains": journal.gains,
        "steps": None if outcome.steps is None else [_steps(one) for one in outcome.steps],
        "written": sorted({axis_of(name) for name in journal.former})
        if journal.gains.startswith("written") else [],
        "seconds": journal.seconds,
    }  # fmt: skip


def _steps(flown: Flown) -> dict[str, dict[str, float]]:
    return {
        one.axis: {
            "rms": missed(one),
            "overshoot": one.measured.overshoot_pct / 100.0,
            "predicted": math.nan if one.predicted is None else one.predicted.overshoot_pct / 100.0,
        }
        for one in flown.axes
    }


def table(lines: Sequence[Line]) -> Iterator[str]:
    """A row a craft, and the acceptance."""
    yield from rows(TITLES, lines, _cells)
    good = [line for line in lines if "error" not in line]
    within = [max(map(abs, one["constants"].values())) <= CONSTANTS_WITHIN for one in good]
    hidden = sum(one["hidden"] for one in good)
    missed_ = sum(len(one["missed"]) for one in good)
    inside, of = (sum(one["sizes"][n] for one in good) for n in (0, 1))
    offs = [_off(one) for one in good if one["steps"]]
    yield ""
    yield f"learnt to the end: {len(good)} of {len(lines)}"
    yield f"constants within {100 * CONSTANTS_WITHIN:g} %: {sum(within)} of {len(lines)}"
    yield f"crafts without a false name: {sum(not one['false'] for one in good)} of {len(lines)}"
    yield f"hidden effects named: {hidden - missed_} of {hidden}"
    yield f"sizes within their 95 %: {inside} of {of}"
    quick = sum(one["search_s"] <= SEARCH_S for one in good)
    yield f"searches within {SEARCH_S:g} s of processor time: {quick} of {len(lines)}"
    yield f"gains written or put back: {sum(bool(one['gains']) for one in good)} of {len(lines)}"
    near = sum(one <= OVERSHOOT_WITHIN for one in offs)
    yield f"overshoot as predicted, within {100 * OVERSHOOT_WITHIN:g} points: {near} of {len(offs)}"


def _off(line: Line) -> float:
    """How far the last flight's overshoots are off the predicted ones, the worst axis."""
    return max(abs(one["overshoot"] - one["predicted"]) for one in line["steps"][1].values())


def _cells(line: Line) -> list[str]:
    if "error" in line:
        return [line["case"], line["error"], *[""] * (len(TITLES) - 2)]
    wrong = [f"missed {name}" for name in line["missed"]] + [f"FALSE {n}" for n in line["false"]]
    gap, steps = line["gap"], line["steps"]
    rms = [np.mean([one["rms"] for one in axes.values()]) for axes in steps or ()]
    return [
        line["case"],
        line["release"],
        " ".join(f"{100.0 * value:+.1f}" for value in line["constants"].values()),
        ", ".join(wrong) or "right",
        "{} of {}".format(*line["sizes"]),
        f"{gap[0]:.2f}, {math.nan if gap[1] is None else gap[1]:.2f} {line['verdict']}",
        f"{line['search_s']:.0f}",
        line["gains"].partition(":")[0] + " " + " ".join(line["written"]),
        ", ".join(f"{one:.3f}" for one in rms),
        f"{100.0 * _off(line):.1f}" if steps else "",
    ]


if __name__ == "__main__":
    sys.exit(main())
