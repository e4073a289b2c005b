"""``python -m bench.fleet_flights``: flights of many crafts, some of which wear, age or crash.

Crafts are drawn from a population; what becomes of one is written to a file apart, never into a
recording. Flights are in folders by craft, named as the daemon names them.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import numpy as np

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.output import write_npz
from firmware_sim.settings import Sensor
from groundstation.dynamics.vehicle import Vehicle, load_vehicle
from groundstation.text import printable

FIRST = datetime(2026, 1, 5, 9, tzinfo=UTC)
BETWEEN = timedelta(hours=7)
SPREAD = {"mass": 0.01, "inertia": 0.02, "thrust": 0.01, "drag": 0.02, "internal_ohm": 0.05}
"""Standard deviation of crafts, as a share."""
FATES = ("rotor", "load", "battery", "shift", "bent")
"""A rotor weaker since a flight, more mass since, resistance that rises, a moved centre of
gravity since, more vibration since a crash that bent an axis."""


@dataclass(frozen=True, slots=True)
class Fate:
    """What becomes of a craft: from flight ``since`` (1 is the first) on, or over all flights."""

    craft: str
    kind: str
    since: int
    size: float
    rotor: int = 0


def main(arguments: list[str] | None = None) -> int:
    """Fly and write. Returns 0, or 1 after one line on stderr."""
    options = _parser().parse_args(arguments)
    try:
        _require(options)
        random = np.random.default_rng(options.seed)
        base = load_vehicle(options.craft)
        crafts = [_drawn(base, random) for _ in range(options.crafts)]
        fates = _fates(options, random)
        options.output.mkdir()
        if options.truth is not None:
            with options.truth.open("x", encoding="utf-8") as file:
                json.dump([asdict(one) for one in fates], file, indent=1)
        _fly_all(options, crafts, fates)
    except (ValueError, OSError) as error:
        print(f"bench.fleet_flights: {printable(str(error))}", file=sys.stderr)
        return 1
    print(f"{options.output}: {options.flights} flights each of {options.crafts} crafts")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m bench.fleet_flights",
        description="Flights of many crafts, some of which wear, age or crash.",
    )
    parser.add_argument("--crafts", type=int, default=20)
    parser.add_argument("--flights", type=int, default=50, help="of each craft")
    parser.add_argument("--for", dest="seconds", type=float, default=60.0, help="of each flight")
    parser.add_argument("--wear", type=int, default=4, help="crafts of which something becomes")
    parser.add_argument("--craft", default="crazyflie1", help="the profile they are all near to")
    parser.add_argument("--program", help="pilot programme, built in or a TOML file")
    parser.add_argument("--plant", choices=("reduced", "faithful"), default="faithful")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, required=True, help="a new folder")
    parser.add_argument("--truth", type=Path, help="a new file for what became of whom")
    return parser


def _require(options: argparse.Namespace) -> None:
    for name, least in (("crafts", 1), ("flights", 1), ("wear", 0), ("seed", 0)):
        if getattr(options, name) < least:
            raise ValueError(f"--{name} {getattr(options, name)}: must be {least} or more")
    if options.wear > options.crafts:
        raise ValueError(f"--wear {options.wear}: there are {options.crafts} crafts")
    if not 1.0 <= options.seconds <= 3600.0:
        raise ValueError(f"--for {options.seconds:g}: must be 1 to 3600 seconds")
    if options.truth is not None and options.truth.absolute().is_relative_to(
        options.output.absolute()
    ):
        raise ValueError(f"{options.truth}: the truth must not lie among the recordings")
    for path in filter(None, (options.output, options.truth)):
        if path.exists():
            raise ValueError(f"{path}: exists already; give another name or remove it")


def _drawn(base: Vehicle, random: np.random.Generator) -> Vehicle:
    """A craft of the population."""

    def near(value: float, name: str) -> float:
        return float(value * math.exp(random.normal(0.0, SPREAD[name])))

    # Second moments of the mass along each axis: whatever they are, a body can have them.
    roll, pitch, yaw = base.inertia_kg_m2
    x, y, z = (near(0.5 * (roll + pitch + yaw) - one, "inertia") for one in base.inertia_kg_m2)
    battery = msgspec.structs.replace(
        base.battery, internal_ohm=near(base.battery.internal_ohm, "internal_ohm")
    )
    return msgspec.structs.replace(
        base,
        mass_kg=near(base.mass_kg, "mass"),
        inertia_kg_m2=(y + z, x + z, x + y),
        thrust_n=near(base.thrust_n, "thrust"),
        drag_n_m=near(base.drag_n_m, "drag"),
        battery=battery,
    )


def _fates(options: argparse.Namespace, random: np.random.Generator) -> list[Fate]:
    """Of different crafts, at flights that leave something before and after."""
    chosen = random.permutation(options.crafts)[: options.wear]
    found = []
    for i, craft in enumerate(sorted(int(one) for one in chosen)):
        kind = FATES[(i + options.seed) % len(FATES)]
        since = int(random.integers(options.flights // 3, 2 * options.flights // 3 + 1)) + 1
        rotor = int(random.integers(1, 5))
        size = {
            "rotor": -float(random.uniform(0.04, 0.08)),
            "load": float(random.uniform(0.04, 0.08)),
            "battery": float(random.uniform(0.5, 1.0)),
            "shift": float(random.uniform(0.0008, 0.0015)),
            "bent": float(random.uniform(0.5, 1.0)),
        }[kind]
        found.append(
            Fate(
                _name(craft),
                kind,
                1 if kind == "battery" else since,
                size,
                rotor if kind == "rotor" else 0,
            )
        )
    return found


def _name(craft: int) -> str:
    return f"cf{craft + 1:02d}"


def _fly_all(options: argparse.Namespace, crafts: list[Vehicle], fates: list[Fate]) -> None:
    by_craft = {one.craft: one for one in fates}
    for place, vehicle in enumerate(crafts):
        name = _name(place)
        folder = options.output / name
        folder.mkdir()
        with tempfile.TemporaryDirectory() as profiles:
            settings = [
                _flight(options, vehicle, by_craft.get(name), place, flight, Path(profiles))
                for flight in range(options.flights)
            ]
            names = {one.seed: folder / _file(flight) for flight, one in enumerate(settings)}

            def fly(craft: StandIn, names: dict[int, Path] = names) -> None:
                path = names[craft.settings.seed]
                write_npz(path, *craft.advance(options.seconds), options.craft)

            ready = [StandIn(one) for one in settings]
            with ThreadPoolExecutor(os.cpu_count()) as pool:  # kernels hold no interpreter lock
                list(pool.map(fly, ready))


def _file(flight: int) -> str:
    return f"{FIRST + flight * BETWEEN:%Y-%m-%dT%H-%M-%SZ}_stand-in.npz"


def _flight(
    options: argparse.Namespace,
    vehicle: Vehicle,
    fate: Fate | None,
    place: int,
    flight: int,
    folder: Path,
) -> StandInSettings:
    effects: dict[str, dict[str, float]] = {}
    sensor = Sensor()
    if fate is not None and flight + 1 >= fate.since:
        if fate.kind == "rotor":
            effects["rotor_mismatch"] = {"rotor": float(fate.rotor), "excess": fate.size}
        elif fate.kind == "bent":
            still = sensor.shake
            more = 1.0 + fate.size
            sensor = Sensor(shake=(more * still[0], more * still[1], more * still[2]))
        elif fate.kind == "load":
            effects["mass_change"] = {"percent": 100.0 * fate.size}
        elif fate.kind == "shift":
            effects["centre_of_gravity_offset"] = {"x_m": fate.size, "y_m": 0.0}
        else:
            aged = 1.0 + fate.size * flight / max(1, options.flights - 1)
            battery = msgspec.structs.replace(
                vehicle.battery, internal_ohm=vehicle.battery.internal_ohm * aged
            )
            vehicle = msgspec.structs.replace(vehicle, battery=battery)
    profile = folder / f"{flight}.toml"
    profile.write_text(_profile(options.craft, vehicle), encoding="utf-8")
    programme = {} if options.program is None else {"program": options.program}
    return StandInSettings(
        craft=str(profile),
        **programme,
        plant=options.plant,
        effects=effects,
        sensor=sensor,
        seed=1_000_000 * options.seed + 1000 * place + flight,
        copies=2,
    )


def _profile(base: str, vehicle: Vehicle) -> str:
    """TOML of what differs from the profile that the crafts are near to."""
    lines = [f'base = "{base}"', f'name = "{vehicle.name}"']
    lines += [f"{key} = {getattr(vehicle, key)!r}" for key in ("mass_kg", "thrust_n", "drag_n_m")]
    lines.append(f"inertia_kg_m2 = {list(vehicle.inertia_kg_m2)!r}")
    lines.append("[battery]")
    lines += [f"{key} = {value!r}" for key, value in msgspec.to_builtins(vehicle.battery).items()]
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    sys.exit(main())
