"""The stand-in as a program of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from firmware_sim.__main__ import main
from firmware_sim.craft import StandIn, StandInSettings
from groundstation.dynamics.model import THESIS, save_model
from support.programs import Program, run_program


def test_a_fast_flight_is_written_as_it_was_received(tmp_path):
    path, truth = tmp_path / "flight.npz", tmp_path / "truth.npz"
    arguments = ["--for", "5", "--fast", "--seed", "3", "-o", str(path), "--truth", str(truth)]
    assert main(arguments) == 0
    packets, arrivals = StandIn(StandInSettings(seed=3)).advance(5.0)
    with np.load(path) as stored:
        assert (stored["packets"] == packets).all()
        assert (stored["arrival_s"] == arrivals).all()
        assert set(stored.files) == {"packets", "arrival_s", "vehicle"}
        assert str(stored["vehicle"]) == "crazyflie1"
    with np.load(truth) as stored:
        assert len(stored["truth"]) == pytest.approx(2490, abs=10)


def test_it_runs_beside_a_folder_that_is_called_like_the_package(tmp_path):
    (tmp_path / "groundstation").mkdir()  # a clone has that name
    command = [sys.executable, "-m", "firmware_sim", "--for", "0.5", "--fast", "-o", "flight.npz"]
    done = run_program(command, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "flight.npz").is_file()


def test_real_time_and_fast_give_the_same_bytes(tmp_path):
    fast, real = tmp_path / "fast.npz", tmp_path / "real.npz"
    assert main(["--for", "1.5", "--fast", "-o", str(fast)]) == 0
    assert main(["--for", "1.5", "-o", str(real)]) == 0
    with np.load(fast) as one, np.load(real) as other:
        assert one["packets"].tobytes() == other["packets"].tobytes()
        assert one["arrival_s"].tobytes() == other["arrival_s"].tobytes()


def test_a_csv_has_the_telemetry_layout(tmp_path):
    path = tmp_path / "flight.csv"
    assert main(["--for", "5", "--fast", "-o", str(path)]) == 0
    header, *_ = path.read_text().splitlines()
    assert header.startswith("Timestamp,Battery,Motor1,Motor2,Motor3,Motor4,GyroX")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    assert table.shape == (pytest.approx(2490, abs=10), 16)
    assert np.diff(table[:, 0]).mean() == pytest.approx(1972.6, abs=0.1)


def test_settings_come_from_toml_and_the_command_line_wins(tmp_path):
    toml = tmp_path / "craft.toml"
    toml.write_text('plant = "reduced"\nseed = 9\n[loss]\ngood_loss = 0.0\n')
    paths = [tmp_path / "a.npz", tmp_path / "b.npz"]
    for path, more in zip(paths, ([], ["--seed", "9", "--plant", "faithful"]), strict=True):
        arguments = ["--settings", str(toml), "--for", "2", "--fast", "-o", str(path), *more]
        assert main(arguments) == 0
    with np.load(paths[0]) as one, np.load(paths[1]) as other:
        assert one["packets"].tobytes() != other["packets"].tobytes()


def test_a_model_with_an_effect_flies(tmp_path):
    path = tmp_path / "model.json"
    save_model(THESIS, path)
    document = json.loads(path.read_text())
    document["effects"] = [
        {"name": "rotor_drag", "parameters": {"drag_n_s_m": {"value": 0.01, "unit": "N s/m"}}}
    ]
    path.write_text(json.dumps(document))
    craft = StandIn(StandInSettings(craft=str(path), plant="reduced"))
    assert craft._parameters[0]["plane_drag"] == 0.01
    assert craft._parameters[0]["thrust"] / craft._parameters[0]["mass"] == pytest.approx(4.2e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fast"], "--for"),
        (["--for", "-1"], "must be positive"),
        (["--for", "1", "--fast", "--effect", "nonsense"], "nonsense"),
        (["--for", "1", "--fast", "--effect", "rotor_drag:drag_n_s_m=x"], "no number"),
        (["--for", "1", "--fast", "--program", "nowhere.toml"], "neither built in"),
        (["--for", "1", "--fast", "--craft", "nowhere.json"], "no such file"),
        (["--for", "1", "--fast", "-o", "flight.txt"], ".npz or .csv"),
        (["--for", "1", "--fast", "-o", "/nowhere/flight.npz"], "No such file"),
        (["--for", "1", "--fast", "--crtp", "here"], "HOST:PORT"),
        (["--for", "1", "--fast", "--settings", "nowhere.toml"], "nowhere.toml"),
    ],
)
def test_bad_input_is_one_line_and_status_1(capsys, arguments, message):
    assert main(arguments) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_an_existing_file_is_not_overwritten(tmp_path, capsys):
    path = tmp_path / "flight.npz"
    path.write_bytes(b"precious")
    assert main(["--for", "1", "--fast", "-o", str(path)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert path.read_bytes() == b"precious"


def test_ctrl_c_ends_a_run_in_good_order(tmp_path):
    path = tmp_path / "flight.npz"
    with Program(
        [sys.executable, "-m", "firmware_sim", "--crtp", "127.0.0.1:0", "-o", str(path)],
        stdout=subprocess.PIPE,
        text=True,
    ) as child:
        assert "udp://127.0.0.1" in child.stdout.readline()
        os.kill(child.pid, signal.SIGINT)
        assert child.wait(60) == 0
    with np.load(path) as stored:
        assert len(stored["packets"]) == len(stored["arrival_s"])


def test_help_shows_examples():
    result = run_program([sys.executable, "-m", "firmware_sim", "--help"], check=True)
    assert "examples:" in result.stdout
    assert "--effect" in result.stdout
