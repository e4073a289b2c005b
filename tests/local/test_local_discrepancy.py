"""What a model of a real craft is missing, told nothing: `make check-local`.

imrc/eckart*: figures of eight at five speeds by a craft of another kind (X configuration, 37 g),
5.6 to 9.2 s each, with measured rotor speeds; the attitude is a filter's that uses motion capture.
Each flight is held out once, the model is fitted to the others.

imrc_payload/eckart*: the same craft with 4.7 g on a cable (39.7 g without it, 44.4 g flown).
"""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.discrepancy.engine import find_discrepancy
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.body import identify_body
from groundstation.identification.motor.workflow import identify_motor
from groundstation.identification.runs import flights_of, runs_of, without_gaps
from groundstation.recording.formats import open_recording
from support.daemons import COMMAND
from support.programs import run_program

DATA = os.environ.get("GROUNDSTATION_LOCAL_DATA")
pytestmark = pytest.mark.skipif(
    DATA is None or not Path(DATA).is_dir(),
    reason="GROUNDSTATION_LOCAL_DATA names no folder with imrc/ and imrc_payload/",
)
FLIGHTS = ("00", "12", "22", "27", "34")
PROFILE = Path(__file__).parents[2] / "bench" / "real" / "brushless.toml"
VEHICLE = load_vehicle(PROFILE)
ARTEFACTS = ("motor_braking_asymmetry", "attitude_filter_lean", "yaw_damping", "gyro_low_pass")


@pytest.fixture(scope="module")
def samples():
    return {n: open_recording(Path(DATA) / "imrc" / f"eckart{n}").samples for n in FLIGHTS}


def flights(samples, names, measured):
    found = [run for name in names for run in flights_of(samples[name], name)]
    if measured:
        return found
    return [replace(one, rotor_rev_s=np.full_like(one.rotor_rev_s, np.nan)) for one in found]


def searched(samples, held, measured):
    """What is found on four flights, the model being fitted to them, with ``held`` held out."""
    fitted = [name for name in FLIGHTS if name != held]
    spun = [run for name in fitted for run in runs_of(samples[name], name)]
    motor = identify_motor(spun, [], vehicle_model(VEHICLE), VEHICLE).model
    fit_on, judged = (
        [flights(samples, [name], measured) for name in names] for names in (fitted, [held])
    )
    model = identify_body(
        *([without_gaps(run) for flown in part for run in flown] for part in (fit_on, judged)),
        motor,
        VEHICLE,
        measured=measured,
    ).model
    return find_discrepancy(fit_on, model, judged).findings


@pytest.mark.parametrize(
    ("held", "measured"),
    [
        ("00", True),
        ("12", True),
        ("22", True),
        ("27", True),
        ("34", True),
        ("34", False),
    ],
)
def test_the_rotors_acceleration_and_the_moment_of_velocity_are_named(samples, held, measured):
    found = searched(samples, held, measured)
    named = {effect.name: effect for effect in found.effects}
    for effect in found.effects:
        print(effect.name, {k: f"{e.value:.3g}" for k, e in effect.parameters.items()})
    assert {"rotor_acceleration_torque", "velocity_moment"} <= set(named)
    assert not set(ARTEFACTS) & set(named)
    inertia = named["rotor_acceleration_torque"].parameters["rotor_inertia_kg_m2"].value
    assert 2e-8 < inertia < 9e-8
    assert 15 < named["velocity_moment"].parameters["moment"].value < 40


@pytest.fixture(scope="module")
def carrying(tmp_path_factory):
    """What ``discrepancy`` says of flights with payload, as typed, by a model from flights without
    it; and by the model that it made of those."""
    folder, imrc = tmp_path_factory.mktemp("payload"), Path(DATA) / "imrc"
    light, load = [str(imrc / f"eckart{n}") for n in FLIGHTS], Path(DATA) / "imrc_payload"
    vehicle = ("--vehicle", str(PROFILE))

    def typed(*arguments):
        run_program([COMMAND, *arguments], cwd=folder, timeout=900, check=True)

    typed("fit", "motor", *light, *vehicle, "-o", "motor.json")
    typed("fit", "body", *light, *vehicle, "--model", "motor.json", "-o", "body.json")
    typed("discrepancy", *light, "--model", "body.json", "-o", "named.json", "--json", "light.json")
    for model in ("body", "named"):
        typed(
            *("discrepancy", str(load / "eckart06"), str(load / "eckart20")),
            *("--validate", str(load / "eckart12"), "--validate", str(load / "eckart26")),
            *("--model", f"{model}.json", "--json", f"load_{model}.json"),
        )
    names = ("light", "load_body", "load_named")
    return {name: json.loads((folder / f"{name}.json").read_text()) for name in names}


@pytest.mark.parametrize("model", ["body", "named"])
def test_a_payload_is_named_with_its_mass_and_no_other_name_is_new(carrying, model):
    found = {one["name"]: one["parameters"] for one in carrying[f"load_{model}"]["effects"]}
    known = {one["name"] for one in carrying["light"]["effects"]}
    assert 14 < found["mass_change"]["percent"]["value"] < 20
    assert not set(found) - known - {"mass_change", "slung_load"}


@pytest.mark.parametrize("model", ["body", "named"])
def test_what_swings_below_the_craft_is_named_or_left_below_two_hertz(carrying, model):
    report = carrying[f"load_{model}"]
    assert report["residual"] == "structured"
    worst = [one for one in report["left"] if one["channel"] in ("gyro_x", "gyro_y")]
    named = any(one["name"] == "slung_load" for one in report["effects"])
    assert named or (worst and all(one["band_hz"][1] <= 2.0 for one in worst))
    for channel in report["gap"]["channels"].values():
        assert channel["after"] < 1.02 * channel["before"]
