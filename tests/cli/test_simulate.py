"""simulate as a user types it, and a model with effects given to the stand-in link."""

import json

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.dynamics.model import EffectTerm, Estimate, save_model
from groundstation.errors import BadInputError
from groundstation.recording.csv_file import write_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.session import Recording
from support.commands import run
from support.daemons import Daemon
from support.flights import BASE, CARRYING_GAINS, MEDIUM, affected, recorded

OWN = """
from groundstation.dynamics.effect import Effect, Parameter

def sail(values, craft, body):
    return (0.0, 0.0, values[0]), (0.0, 0.0, 0.0)

SAIL = Effect("sail", "body", (Parameter("torque", "rad/s^2", 1.0, -9.0, 9.0),),
              "a constant torque on yaw", "it turns", "hover", ("gyro z",), law=sail)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A flight with blade flapping, a bench, the base model and the one that knows."""
    folder = tmp_path_factory.mktemp("simulate")
    name = "velocity_moment"
    for file, seconds, settings in (
        ("flight", 25.0, {"effects": {name: MEDIUM[name]}, "gains": CARRYING_GAINS}),
        ("bench", 5.0, {"program": "wait"}),
    ):
        samples, _ = recorded(seconds, seed=8, plant="reduced", **settings)
        write_csv(Recording(folder / f"{file}.csv", "csv", samples), folder / f"{file}.csv")
    save_model(BASE, folder / "base.json")
    save_model(affected(name), folder / "knows.json")
    return folder


def simulated(folder, model, output, *more):
    text = run(
        *("simulate", "--model", folder / model, "--recording", folder / "flight.csv"),
        *("-o", output, "--json", *more),
    )
    return json.loads(text)


def test_the_models_effects_act_on_a_recordings_inputs(folder, tmp_path):
    base = simulated(folder, "base.json", tmp_path / "base.csv")
    knows = simulated(folder, "knows.json", tmp_path / "knows.csv")
    assert knows["effects"] == ["velocity_moment"]
    for axis in ("roll_deg", "pitch_deg"):
        assert knows["rms"][axis] < 0.3 * base["rms"][axis]
    table = np.genfromtxt(tmp_path / "knows.csv", delimiter=",", names=True)
    assert len(table) == knows["rows"] > knows["rows_in_the_air"] > 8000
    assert table["rotor1_rev_s"].max() > 200


def test_a_reference_is_flown_on_made_inputs(folder, tmp_path):
    text = run(
        *("simulate", "--model", folder / "knows.json", "--reference", "doublet"),
        *("-o", tmp_path / "made.csv"),
    )
    assert "along doublet" in text
    table = np.genfromtxt(tmp_path / "made.csv", delimiter=",", names=True)
    assert table["reference_roll_deg"].max() == pytest.approx(10.0)
    assert table["roll_deg"].max() > 7.0
    assert 0.0 < table["duty1"].min() <= table["duty1"].max() < 1.0


def test_exactly_one_source_of_inputs_must_be_named(folder, tmp_path):
    command = ["simulate", "--model", "thesis", "-o", str(tmp_path / "x.csv")]
    assert CliRunner().invoke(app, command).exit_code == 2
    both = ["--recording", str(folder / "flight.csv"), "--reference", "hover"]
    assert CliRunner().invoke(app, command + both).exit_code == 2


def test_a_recording_that_never_flies_is_refused(folder, tmp_path):
    output = tmp_path / "x.csv"
    with pytest.raises(BadInputError, match="never leaves the ground"):
        run(
            *("simulate", "--model", folder / "base.json"),
            *("--recording", folder / "bench.csv", "-o", output),
        )
    assert not output.exists()


def test_the_stand_in_link_flies_a_model_with_listed_and_own_effects(tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    own = EffectTerm("sail", {"torque": Estimate(4.0)}, "mine.py")
    model = msgspec.structs.replace(BASE, effects=(*affected("gyro_bias").effects, own))
    save_model(model, tmp_path / "model.json")
    configuration = tmp_path / "station.toml"
    configuration.write_text(
        f'[stand_in]\nplant = "reduced"\nprogram = "hover"\ncraft = "{tmp_path / "model.json"}"\n'
    )
    with Daemon(tmp_path, "--config", configuration, "--speed", "max") as daemon:
        daemon.recording(samples=5000)
        assert daemon.stop() == 0
        samples = open_recording(daemon.only_file()).samples[:5000]
    resting, flying = samples.gyro[:500], samples.gyro[-1500:]
    # The bias shows at rest; in the air the yaw controller works against the sail.
    assert np.degrees(resting.mean(axis=0))[:2] == pytest.approx([1.5, -1.0], abs=0.1)
    spread = samples.duty[-1500:].mean(axis=0)
    assert (spread[0] + spread[2] - spread[1] - spread[3]) > 0.02
    assert np.isfinite(flying).all()
