"""A recording of ``pid fly`` is good to fit on: the truth comes out of it."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from firmware_sim.craft import StandInSettings
from groundstation.cli.app import app
from groundstation.control.firmware_loop import load_gains
from groundstation.control.programme import Programme
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.recording.csv_file import write_csv
from groundstation.recording.session import Recording
from support.flights import fly_offline

GAINS = load_gains(Path(__file__).parent / "data" / "gains.toml")


def test_c0_c1_c2_are_found_in_a_flown_programme(tmp_path):
    settings = StandInSettings(program="wait", altitude_hold=True, gains=GAINS, seed=8)
    samples, *_ = fly_offline(settings, Programme(repeats=8), jitter_s=0.003)
    flight, model = tmp_path / "flight.csv", tmp_path / "body.json"
    write_csv(Recording(flight, "csv", samples), flight)
    effects = "dead_time,rotor_acceleration_torque"
    result = CliRunner().invoke(
        app, ["fit", "body", str(flight), "-o", str(model), "--with", effects, "--json"]
    )
    assert result.exit_code == 0, result.output or result.exception
    body = json.loads(model.read_text())["body"]
    found = [body[name] for name in ("c0", "c1", "c2")]
    assert found == pytest.approx(BUILT_IN["crazyflie1"].body_constants, rel=0.03)
