"""The live twin: how often it errs, how soon it sees, what it costs (docs/evidence.md).

``python -m bench.twin clean FOLDER HOURS`` and ``python -m bench.twin effects FOLDER``.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from bench.sealed.bound import significances
from bench.sealed.cases import NO_SMALL_SIZE, named
from bench.sealed.flights import CARRY, PROGRAMME, Generator, command, vehicle_of
from bench.sealed.flights import flown as sealed_flight
from bench.sealed.hidden import CHANNELS, LISTED, planted, scaled
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.effects.catalogue import draw
from groundstation.dynamics.model import EffectTerm, Estimate, Model, load_model
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch, SampleBatch
from groundstation.twin.twin import Episode, Twin, in_words

PLANTS = ("reduced", "faithful")
KNOWN = (
    "dead_time,inertia_coupling,rotor_gyroscopic_torque,rotor_acceleration_torque,"
    "battery_reading_lag,supply_sag"
)
START_NS = 1_700_000_000_000_000_000
PIECE_ROWS = 250
SIGMAS = (10.0, 20.0, 40.0, 80.0)
FLIGHTS: tuple[tuple[float, dict[str, Any]], ...] = (
    (600.0, {"program": "excite"}),
    (60.0, {"program": PROGRAMME}),
    (60.0, {"program": PROGRAMME, "loss": {"good_loss": 0.02}}),
    (300.0, {"program": "hover"}),
    (600.0, {"program": "excite", "charge": 0.3, "recharge_s": 5.0}),
    (60.0, {"program": PROGRAMME, "loss": {"to_bad": 0.0005, "to_good": 0.01}}),
    (120.0, {"program": "excite", "gains": {}}),
)
"""Seconds and settings of what is flown without an effect, again and again: excitation, hover,
take-offs and landings, empty batteries and restarts, lost rows alone and in bursts, stock gains."""


def fitted(folder: Path) -> dict[str, Model]:
    """A model for each plant, fitted by the installed command on flights without an effect."""
    generator = Generator(folder)
    models = {}
    for plant, group in zip(PLANTS, ("quiet", "faithful"), strict=True):
        family = generator.family(named(f"{group}:nothing:0:clean"))
        model = load_model(family / "base.json")
        if plant == "faithful":
            out = folder / "faithful.json"
            if not out.exists():
                flights = (family / "clean0.mcap", family / "clean1.mcap")
                command(
                    *("fit", "body", *flights, "--model", family / "motor.json", "-o", out),
                    *("--with", KNOWN, "--vehicle", vehicle_of(family)),
                )
            # the firmware's filter is known, and no body fit can see it
            lean = EffectTerm("attitude_filter_lean", {"strength": Estimate(1.0)})
            model = load_model(out)
            model = msgspec.structs.replace(model, effects=(*model.effects, lean))
        else:
            (folder / "twin.json").write_bytes((family / "base.json").read_bytes())
        models[plant] = model
    return models


@dataclass
class Clean:
    """Flights without an effect. hours: flown; share: of a core, per flown second."""

    hours: float = 0.0
    share: float = 0.0
    flights: int = 0
    events: list[tuple[int, Episode]] = field(default_factory=list)


def clean(plant: str, model: Model, hours: float, seed: int = 0, tell: bool = False) -> Clean:
    """Fly until so many hours have been in the air."""
    done, taken_s = Clean(), 0.0
    while done.hours < hours:
        seconds, settings = FLIGHTS[done.flights % len(FLIGHTS)]
        number = 10_000 * (seed + 1) + done.flights
        samples = flown({"plant": plant, "seed": number, **settings}, seconds)
        began_s = time.process_time()
        told = [each for _, each in watched(model, samples) if each.end_s is None]
        taken_s += time.process_time() - began_s
        done.events += [(number, each) for each in told]
        done.hours += float((samples.duty > 0.1).all(axis=1).sum()) * 0.002 / 3600.0
        done.flights += 1
        if tell:
            for each in told:
                print(f"  {plant} {settings} seed {number}: {in_words(each)}", flush=True)
            if done.flights % len(FLIGHTS) == 0:
                print(f"  {plant}: {done.hours:.2f} h, {len(done.events)} events", flush=True)
    done.share = taken_s / (done.hours * 3600.0)
    return done


ONSET_S = {
    **dict.fromkeys(LISTED, 9.0),  # the first doublet, in roll
    **dict.fromkeys(
        ("centre_of_gravity_offset", "rotor_mismatch", "motor_dead_voltage", "supply_sag",
         "gyro_bias", "accelerometer_bias", "imu_misalignment", "ground_effect"), 3.0,
    ),  # take-off
    **dict.fromkeys(("rotor_acceleration_torque", "yaw_damping"), 15.0),
    **dict.fromkeys(("rotor_gyroscopic_torque", "inertia_coupling", "climb_inflow"), 18.0),
    "battery_reading_lag": 38.0,
}  # fmt: skip
"""When the programme first excites an effect, by its own segments."""


def effects(model: Model, folder: Path) -> None:
    """When the twin tells of each effect, at multiples of the bound's standard error."""
    sizes_path = folder / "sizes.json"
    if not sizes_path.exists():
        sizes_path.write_text(json.dumps({name: _one_sigma(name) for name in LISTED}))
    sizes = json.loads(sizes_path.read_text())
    print("| effect | size | " + " | ".join(f"{each:g} sigma" for each in SIGMAS) + " |")
    print("|---|---|" + "---|" * len(SIGMAS))
    for name in LISTED:
        if name in NO_SMALL_SIZE:
            continue
        cells = []
        for sigmas in SIGMAS:
            values = scaled(name, sizes[name], sigmas)
            settings = {"effects": planted(name, values, True), "program": PROGRAMME}
            samples = flown({"plant": "reduced", "seed": 77, **settings}, 60.0)
            told = [(at, each) for at, each in watched(model, samples) if each.end_s is None]
            right = [at for at, each in told if _fits(name, each)]
            wrong = "" if not told or _fits(name, told[0][1]) else "!"
            cells.append(f"{right[0] - ONSET_S[name]:.0f} s{wrong}" if right else f"-{wrong}")
        size = ", ".join(f"{key} {value:.2g}" for key, value in sizes[name].items())
        print(f"| {name} | {size} | " + " | ".join(cells) + " |", flush=True)


def _fits(name: str, episode: Episode) -> bool:
    channel = episode.place.channel.replace("_", " ")
    return any(channel.startswith(each) for each in CHANNELS[name])


def _one_sigma(name: str) -> dict[str, float]:
    """An effect one standard error of the Cramer-Rao bound large, on two flights of 60 s."""
    values = draw(name, np.random.default_rng(5))
    if name in NO_SMALL_SIZE:
        return values
    usual = {"plant": "reduced", "craft": "crazyflie1", "program": PROGRAMME, "gains": CARRY,
             "copies": 1, "loss": {"good_loss": 0.0}}  # fmt: skip
    for _ in range(2):
        trial = {**usual, "effects": planted(name, values, True)}
        flights = [sealed_flight({**trial, "seed": 100 + k}, 60.0)[1] for k in range(2)]
        found = significances(msgspec.convert(trial, StandInSettings), flights)[name]
        values = scaled(name, values, 10.0 / found)
    return scaled(name, values, 0.1)


def watched(model: Model, samples: SampleBatch) -> Iterator[tuple[float, Episode]]:
    """(device time at which it was told, episode), as the daemon would feed the twin."""
    twin = Twin(model)
    for first in range(0, len(samples), PIECE_ROWS):
        piece = samples[first : first + PIECE_ROWS]
        for _, told in twin.feed(piece):
            for episode in told:
                yield float(piece.time_s[-1]), episode


def flown(settings: dict[str, Any], seconds: float) -> SampleBatch:
    """A stand-in's flight as a ground station decodes it."""
    usual = {"gains": CARRY, "copies": 1, "loss": {"good_loss": 0.0}}
    craft = StandIn(msgspec.convert({**usual, **settings}, StandInSettings))
    packets, heard_s = craft.advance(seconds)
    samples, _ = decode_all(RawBatch(packets, START_NS + np.rint(heard_s * 1e9).astype(np.int64)))
    return samples


def main(arguments: list[str]) -> int:
    what, folder = arguments[0], Path(arguments[1])
    models = fitted(folder)
    if what == "effects":
        effects(models["reduced"], folder)
    if what == "clean":
        for plant in arguments[3:] or PLANTS:
            done = clean(plant, models[plant], float(arguments[2]), tell=True)
            print(
                f"{plant}: {done.hours:.2f} h in the air, {done.flights} flights,"
                f" {len(done.events)} false events, {len(done.events) / done.hours:.2f} an hour,"
                f" {100 * done.share:.2f} % of a core",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
