"""A user's own effect among the candidates: from a file to a model that flies better."""

import json
import math
import os
import subprocess
from pathlib import Path

import msgspec
import numpy as np
import pytest
from affected_flights import BASE
from installed import COMMAND, groundstation
from stand_in_flights import CARRYING_GAINS, recorded

from groundstation.discrepancy.own_candidates import joined, own_effects, own_terms
from groundstation.dynamics.model import EffectTerm, Estimate, load_model, save_model
from groundstation.errors import BadInputError
from groundstation.recording.recording_file import RecordingFile, session_metadata

VANE = Path(__file__).parent / "data" / "weather_vane.py"
TURN = 3.0
SETTINGS = {"plant": "reduced", "gains": CARRYING_GAINS}


def with_vane(turn, **more):
    values = {"turn": Estimate(turn, None, "rad/s^2 per m/s"), **more}
    term = EffectTerm("weather_vane", values, str(VANE))
    return msgspec.structs.replace(BASE, effects=(term,))


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """The folder after a search for a vane that the list of effects lacks, and what was said."""
    folder = tmp_path_factory.mktemp("own")
    save_model(with_vane(TURN), folder / "hidden.json")
    save_model(BASE, folder / "base.json")
    for number in (1, 2):
        samples, _ = recorded(
            40.0, **SETTINGS, seed=number, craft=str(folder / "hidden.json"), copies=1
        )
        out = RecordingFile(
            folder / f"flight{number}.mcap", {"session": session_metadata("stand-in")}
        )
        out.samples(samples)
        out.finish()
    # The user's own copy: nothing of the hidden craft's files is read.
    (folder / "mine.py").write_text(VANE.read_text())
    done = subprocess.run(
        [
            *(COMMAND, "discrepancy", "flight1.mcap", "--validate", "flight2.mcap"),
            *("--model", "base.json", "--effects", "mine.py"),
            *("-o", "improved.json", "--json", "report.json"),
        ],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "NO_COLOR": "1"},
        timeout=280,
    )
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


def test_the_users_effect_is_named_and_nothing_else(searched):
    folder, said = searched
    report = json.loads((folder / "report.json").read_text())
    assert [effect["name"] for effect in report["effects"]] == ["weather_vane"]
    turn = report["effects"][0]["parameters"]["turn"]
    assert abs(turn["value"] - TURN) < 3 * turn["stderr"]
    assert "1. weather_vane: yaw turns towards where the air comes from" in said


def test_the_gap_closes_on_the_flight_that_was_held_out(searched):
    folder, _ = searched
    gap = json.loads((folder / "report.json").read_text())["gap"]["channels"]["gyro_z"]
    assert gap["before"] > 1.5 > 1.1 > gap["after"]


def test_the_improved_model_names_the_file_and_simulates(searched):
    folder, _ = searched
    (term,) = load_model(folder / "improved.json").effects
    assert (term.name, Path(term.source)) == ("weather_vane", folder / "mine.py")
    done = groundstation(
        *("simulate", "--model", "improved.json", "--recording", "flight2.mcap"),
        *("-o", "simulated.csv", "--json"),
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr


def test_sizes_are_what_alone_makes_a_difference():
    """``fade`` only shapes what ``turn`` does: it stays at its default, or at the model's value."""
    (vane,) = own_effects(VANE)
    assert vane.sizes == ("turn",)
    assert vane.reference == {"turn": 0.0, "fade": 10.0}
    known, point = own_terms(with_vane(2.0, fade=Estimate(3.0)))
    assert known[0].reference["fade"] == 3.0
    assert point == {"weather_vane.turn": 2.0}


@pytest.mark.parametrize(
    ("law", "sizes"),
    [("a * p / b + c * p / d", ("a", "c")), ("a * p / b + c * p * p / b", ("a", "c"))],
)
def test_sizes_are_told_from_lengths_that_the_law_divides_by(tmp_path, law, sizes):
    path = tmp_path / "divided.py"
    names = ("a", "b", "c", "d")
    path.write_text(
        "from groundstation.dynamics.effects.catalogue import Effect, Parameter\n"
        "def law(values, state, slope, acceleration):\n"
        "    a, b, c, d = values\n"
        "    p = state[10]\n"
        f"    acceleration[0] += {law}\n"
        f"ONE = Effect('divided', 'body', tuple(Parameter(n, '', 2.0, 1.0, 9.0) for n in {names}),"
        " '', '', '', ('gyro x',), law=law)\n"
    )
    (one,) = own_effects(path)
    assert one.sizes == sizes


def test_columns_are_the_laws_own_derivatives():
    (vane,) = own_effects(VANE)
    states = np.zeros((4, 17))
    states[:, 6] = 1.0
    states[:, 4] = [0.5, -1.0, 0.0, 20.0]
    column = vane.column("weather_vane.turn", {}, states, np.zeros((4, 4)))
    expected = 10.0 * np.tanh(states[:, 4] / 10.0)
    np.testing.assert_allclose(column[:, 2], expected, rtol=1e-9)
    assert not column[:, [0, 1, 3, 4, 5]].any()
    assert math.isclose(vane.range_of("weather_vane.turn")[1], 50.0)


def test_a_file_that_is_none_and_an_effect_that_does_nothing_are_refused(tmp_path):
    with pytest.raises(BadInputError, match="no such file"):
        own_effects(tmp_path / "nowhere.py")
    idle = tmp_path / "idle.py"
    idle.write_text(VANE.read_text().replace("acceleration[2] +=", "left +="))
    with pytest.raises(BadInputError, match="weather_vane adds nothing"):
        own_effects(idle)


def test_one_name_from_two_files_is_refused(tmp_path):
    other = tmp_path / "other.py"
    other.write_text(VANE.read_text())
    with pytest.raises(BadInputError, match="weather_vane: defined in"):
        joined(own_effects(VANE), own_effects(other))
