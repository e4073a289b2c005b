"""What was not fitted is never flown as a model: files say it, commands tell or refuse it."""

import json
import sys
from pathlib import Path

import pytest

from firmware_sim.craft import StandIn, StandInSettings
from groundstation.dynamics.model import load_model
from groundstation.errors import BadInputError
from groundstation.recording.csv_file import write_csv
from groundstation.recording.session import Recording
from support.commands import run
from support.flights import recorded
from support.programs import run_program
from support.waiting import PATIENCE_S

COMMAND = Path(sys.executable).parent / "groundstation"
NOT_FITTED = r"its body constants are those of the profile 'crazyflie1', not fitted"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two recordings of the reduced craft, and what is fitted on them as a user would."""
    folder = tmp_path_factory.mktemp("fitted")
    for name, seconds, program in (("bench", 40.0, "motor_bench"), ("flight", 40.0, "excite")):
        samples, _ = recorded(seconds, seed=41, plant="reduced", program=program)
        write_csv(Recording(folder / f"{name}.csv", "csv", samples), folder / f"{name}.csv")
    found = {name: folder / name for name in ("bench.csv", "flight.csv")}
    for name, arguments in {
        "motor.json": ("motor", found["bench.csv"]),
        "arx.json": ("arx", found["flight.csv"]),
        "body.json": ("body", found["flight.csv"]),
    }.items():
        found[name] = folder / name
        run("fit", *arguments, "-o", found[name])
    return found


def test_a_file_says_what_was_fitted_and_what_is_the_profiles(files):
    assert load_model(files["motor.json"]).origin == {"motor": "fitted", "body": "profile"}
    assert load_model(files["body.json"]).origin == {"motor": "profile", "body": "fitted"}
    assert load_model(files["arx.json"]).origin == {
        "motor": "profile",
        "body": "profile",
        "arx": "fitted",
    }


def test_the_next_fit_keeps_what_the_one_before_found(files, tmp_path):
    path = tmp_path / "both.json"
    text = run("fit", "body", files["flight.csv"], "--model", files["motor.json"], "-o", path)
    assert load_model(path).origin == {"motor": "fitted", "body": "fitted"}
    assert "not fitted" not in text


@pytest.mark.parametrize("model", ["motor.json", "arx.json"])
def test_a_body_that_nobody_fitted_is_refused_where_one_is_needed(files, tmp_path, model):
    path, flight, out = files[model], files["flight.csv"], tmp_path / "out.csv"
    for command in (
        ("simulate", "--model", path, "--recording", flight, "-o", out),
        ("simulate", "--model", path, "--reference", "doublet", "-o", out),
        ("compare", flight, "--model", path),
        ("discrepancy", flight, "--model", path),
    ):
        with pytest.raises(BadInputError, match=NOT_FITTED):
            run(*command)
    assert not out.exists()


def test_gains_are_not_designed_for_a_body_that_nobody_fitted(files):
    for command in (("pid", "design"), ("pid", "evaluate"), ("pid", "fly", "--dry-run")):
        with pytest.raises(BadInputError, match=NOT_FITTED):
            run(*command, "--model", files["motor.json"])


def test_the_twin_watches_with_no_profile(files, tmp_path):
    done = run_program(
        [COMMAND, "run", "--link", "stand-in", "--for", "1", "--twin", files["motor.json"]],
        cwd=tmp_path,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 1
    assert "not fitted" in done.stderr


def test_a_fit_and_every_use_of_it_tell_what_is_the_profiles(files, tmp_path):
    line = "motor constants are those of the profile 'crazyflie1', not fitted"
    written = run("fit", "body", files["flight.csv"], "-o", tmp_path / "again.json")
    assert f"in the file: {line}" in written
    used = run("compare", files["flight.csv"], "--model", files["body.json"])
    assert f"body.json: {line}" in used


def test_the_stand_in_says_that_it_flies_the_profiles_body(files):
    for model, said in (("motor.json", True), ("body.json", False)):
        told = StandIn(StandInSettings(craft=str(files[model]))).added_by_plant
        assert ("body constants of the profile crazyflie1" in told) is said


def test_a_file_of_before_works_as_it_did_and_the_assumption_is_told(files, tmp_path):
    document = json.loads(files["motor.json"].read_text())
    del document["origin"]
    old = tmp_path / "old.json"
    old.write_text(json.dumps(document))
    text = run("compare", files["flight.csv"], "--model", old)
    assert "made before files said what was fitted: its body constants are taken as fitted" in text
    assert "(they equal the profile's)" in text
