"""Flights of the stand-in as recordings, the motor bench, and the base model's fit.

A case's folder holds what the search may see: ``fit1.mcap``, ``fit2.mcap``, ``validate.mcap``,
``model.json`` and, for another craft than the 1.0 or another mass, ``vehicle.toml``.
"""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from bench.command import run_command
from bench.sealed.bound import significances
from bench.sealed.cases import PLAIN, Case
from bench.sealed.hidden import planted
from bench.sealed.radio_log import logged
from firmware_sim.contents import TODAY
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.effects.catalogue import draw
from firmware_sim.physics import parameters, present_effects
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.recording.mcap_file import RecordingFile, session_metadata
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch, SampleBatch

PROGRAMME = str(Path(__file__).with_name("programme.toml"))
VEHICLE = "vehicle.toml"
FLIGHT_S, BENCH_S = 60.0, 64.0
RESTART_CHARGE, RESTART_S, RESTART_FLIGHT_S = 0.1, 3.0, 66.0
LOW_CHARGE = 0.32
OTHER_MASS = (0.85, 1.15)
START_NS = 1_700_000_000_000_000_000
CARRY = {
    "pid_rate.roll_kp": 30.0,
    "pid_rate.pitch_kp": 30.0,
    "pid_attitude.roll_kp": 3.0,
    "pid_attitude.pitch_kp": 3.0,
    "pid_attitude.roll_ki": 3.0,
    "pid_attitude.pitch_ki": 3.0,
}
"""Gains that carry every size of every effect (docs/stand_in.md)."""
CARRY_TODAY = {
    **CARRY,
    "pid_rate.roll_kp": 125.0,
    "pid_rate.pitch_kp": 125.0,
}
"""The same for today's firmware: half of its stock gains, 24 ms of delay margin in roll."""

Effects = dict[str, dict[str, float]]


@dataclass(frozen=True, slots=True)
class Sealed:
    """What the search must not see.

    hidden: what was put in on purpose. present: every listed effect in the craft, name ->
    parameter -> value. significance: size of each present effect in standard errors of its
    Cramer-Rao bound. craft: settings of the stand-in that flew, without seed and condition. also:
    what may be named besides without being asked for, of the same form: the chip's own filter is
    a first-order lag of the gyro, which ``present`` counts into the delay.
    """

    case: str
    hidden: Effects
    present: Effects
    significance: dict[str, float]
    condition: str
    craft: dict[str, Any]
    also: Effects = field(default_factory=dict)


class Generator:
    """Makes the folders of cases; base models are shared by cases of one seed and plant."""

    def __init__(self, families: Path) -> None:
        self._families = families

    def make(self, case: Case, folder: Path) -> Sealed:
        """Write the recordings and the model of ``case`` into ``folder``; the truth is returned."""
        family = self.family(case)
        folder.mkdir(parents=True)
        craft = _craft(case, family)
        hidden = _hidden(case)
        affected = {**craft, "effects": hidden}
        condition = _condition(case)
        seconds = RESTART_FLIGHT_S if case.condition == "restart" else FLIGHT_S
        flights = []
        for number, name in enumerate(("fit1", "fit2", "validate")):
            settings = {**affected, "seed": flight_seed(case, number)}
            samples, truth = flown({**settings, **condition}, seconds)
            record(folder / f"{name}.mcap", samples)
            if number < 2:  # the bound is that of whole flights, whatever became of them
                flights.append(flown(settings, FLIGHT_S)[1] if condition else truth)
        if (family / VEHICLE).exists():
            shutil.copy(family / VEHICLE, folder / VEHICLE)
        if case.mode == "clean":
            shutil.copy(family / "base.json", folder / "model.json")
        else:
            fits = [folder / "fit1.mcap", folder / "fit2.mcap"]
            fit_body(fits, _motor(family), folder / "model.json", vehicle_of(folder))
        truth_settings = msgspec.convert(affected, StandInSettings)
        present, also = present_effects(truth_settings), {}
        if case.plant == "faithful":
            lag_s = float(parameters(truth_settings)[0]["dlpf_s"][0])
            present["dead_time"] = {"delay_s": lag_s + _sample_age(flights)}
            if lag_s:
                also["gyro_low_pass"] = {"bandwidth_hz": 1.0 / (2.0 * math.pi * lag_s)}
        sizes = significances(truth_settings, flights, _motor_covariance(_motor(family)))
        if is_today(case.craft) and "gyro_bias" in sizes:
            sizes["gyro_bias"] = 0.0  # its firmware takes it off what it logs
        return Sealed(
            case.name,
            hidden,
            present,
            sizes,
            case.condition,
            affected,
            also,
        )

    def family(self, case: Case) -> Path:
        """Bench, clean flights and base model of a seed and plant, made once.

        Not for two threads at once.
        """
        mass = OTHER_MASS[case.number % 2] if case.condition == "other_mass" else 1.0
        label = f"{case.craft}-{case.plant}-{case.torque_noise:g}-{case.seed}-{mass:g}"
        family = self._families / label
        if (family / "base.json").exists():
            return family
        shutil.rmtree(family, ignore_errors=True)  # one that was not finished
        family.mkdir(parents=True)
        if mass != 1.0 or case.craft != PLAIN:
            (family / VEHICLE).write_text(_profile(case.craft, mass))
        craft = _craft(case, family)
        seed = 900_000_000 + 100 * case.seed
        vehicle = vehicle_of(family)
        if not is_today(case.craft):  # its log has no debug field for a bench's optical gate
            bench = {**craft, "program": "motor_bench", "gains": {}, "seed": seed}
            record(family / "bench.mcap", flown(bench, BENCH_S)[0])
            known = ["--with", "battery_reading_lag,supply_sag"] if case.plant == "faithful" else []
            command(
                *("fit", "motor", family / "bench.mcap", "-o", family / "motor.json"),
                *("--vehicle", vehicle, *known),
            )
            constants_alone(family / "motor.json")
        paths = [family / f"clean{number}.mcap" for number in range(2)]
        for number, path in enumerate(paths):
            record(path, flown({**craft, "seed": seed + 1 + number}, FLIGHT_S)[0])
        fit_body(paths, _motor(family), family / "base.json", vehicle)
        return family


def is_today(craft: str) -> bool:
    """Whether a built-in vehicle flies today's firmware."""
    return BUILT_IN[craft].firmware == "2.x"


def _motor(family: Path) -> Path | None:
    """The motor bench's model; None for a craft without one, whose profile has the motor."""
    motor = family / "motor.json"
    return motor if motor.exists() else None


def _hidden(case: Case) -> Effects:
    generator = np.random.default_rng(case.number)
    hidden: Effects = {}
    for name in case.names:
        values = draw(name, generator)
        alone = case.seed % 2 == 1 or len(case.names) > 1
        hidden.update(planted(name, values, alone))
    return hidden


def flight_seed(case: Case, number: int) -> int:
    """The stand-in's seed of a case's flight."""
    return case.number % 100_000 * 10 + number


def _craft(case: Case, family: Path) -> dict[str, Any]:
    return {
        "plant": case.plant,
        "craft": vehicle_of(family),
        "program": PROGRAMME,
        "gains": CARRY_TODAY if is_today(case.craft) else CARRY,
        "copies": 1,
        "loss": {"good_loss": 0.0},
        "torque_noise": case.torque_noise,
        "sensor_noise": case.sensor_noise,
    }


def flown(settings: dict[str, Any], seconds: float) -> tuple[SampleBatch, NDArray[np.void]]:
    """(samples as a ground station decodes them, truth) of one flight.

    A craft with today's firmware is heard by its log blocks, any other by the telemetry's packets.
    """
    craft = StandIn(msgspec.convert({"truth": True, **settings}, StandInSettings))
    if craft.protocol >= TODAY:
        return logged(craft, seconds, START_NS, craft.settings.loss.good_loss), craft.truth()
    packets, heard_s = craft.advance(seconds)
    host_ns = START_NS + np.rint(heard_s * 1e9).astype(np.int64)
    samples, _ = decode_all(RawBatch(packets, host_ns))
    return samples, craft.truth()


def record(path: Path, samples: SampleBatch) -> None:
    """Write samples as the daemon would, without the raw packets."""
    out = RecordingFile(path, {"session": session_metadata("stand-in")})
    out.samples(samples)
    out.finish()


def fit_body(recordings: list[Path], motor: Path | None, base: Path, vehicle: str) -> None:
    """motor: the bench's model; None: the vehicle's profile has it."""
    model = ["--model", motor] if motor else []
    command("fit", "body", *recordings, *model, "-o", base, "--vehicle", vehicle)


def constants_alone(motor: Path) -> None:
    """Take out of a bench's model what had to be fitted along: the search has to find it."""
    fields = json.loads(motor.read_text())
    motor.write_text(json.dumps({**fields, "effects": []}))


def command(*arguments: object) -> None:
    """Run the installed command. Raises RuntimeError where it fails."""
    if said := run_command(*arguments).said:
        raise RuntimeError(f"groundstation {arguments[0]} {arguments[1]}: {said}")


def vehicle_of(folder: Path) -> str:
    """What ``--vehicle`` gets for the recordings of a folder."""
    profile = folder / VEHICLE
    return str(profile) if profile.exists() else "crazyflie1"


def _sample_age(flights: list[NDArray[np.void]]) -> float:
    """How old the faithful sensor's samples really were, s: its clock starts at any phase."""
    return float(np.mean([truth["sensor_age_s"].mean() for truth in flights]))


def _condition(case: Case) -> dict[str, Any]:
    if case.condition == "loss":
        return {"loss": {"good_loss": 0.02}}
    if case.condition == "restart":
        return {"charge": RESTART_CHARGE, "recharge_s": RESTART_S}
    if case.condition == "low_battery":
        return {"charge": LOW_CHARGE, "land_when_low": False}
    return {}


def _motor_covariance(motor: Path | None) -> NDArray[np.float64] | None:
    """Covariance of a0, a1, a2 as the bench's fit states it, (3, 3); None without a bench."""
    if motor is None:
        return None
    estimates = json.loads(motor.read_text())["fit"]["motor"]["estimates"]
    rows = [estimates["names"].index(name) for name in ("a0", "a1", "a2")]
    return np.asarray(estimates["covariance"])[np.ix_(rows, rows)]


def _profile(craft: str, mass: float) -> str:
    """The built-in profile as TOML; one with another mass has another name."""
    fields = msgspec.to_builtins(BUILT_IN[craft])
    if mass != 1.0:
        fields["name"], fields["mass_kg"] = f"{craft}_loaded", mass * fields["mass_kg"]
    tables = {key: fields.pop(key) for key in ("motor", "battery", "gains")}
    lines = [f"{key} = {json.dumps(value)}" for key, value in fields.items()]
    for key, table in tables.items():
        lines.append(f"[{key}]")
        lines += [f'"{name}" = {json.dumps(value)}' for name, value in table.items()]
    return "\n".join(lines) + "\n"
