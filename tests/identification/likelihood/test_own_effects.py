"""A user's own effect, one new file: among the candidates, and from there to a better model."""

import json
import os
from pathlib import Path

import msgspec
import pytest

from groundstation.dynamics.model import EffectTerm, Estimate, load_model, save_model
from groundstation.errors import BadInputError
from groundstation.identification.likelihood.motion import (
    estimates_of,
    joined,
    model_of,
    own_effects,
    own_of,
    point_of,
)
from groundstation.recording.mcap_file import RecordingFile, session_metadata
from support.daemons import COMMAND, groundstation
from support.flights import BASE, CARRYING_GAINS, recorded
from support.programs import run_program

VANE = Path(__file__).parent / "data" / "yaw_weather_vane.py"
MOMENT, LAG_S = 3.0, 0.3
SETTINGS = {"plant": "reduced", "gains": CARRYING_GAINS}


def with_vane(moment=MOMENT, lag_s=LAG_S):
    values = {"moment": moment, "lag_s": lag_s}
    term = EffectTerm("yaw_weather_vane", {k: Estimate(v) for k, v in values.items()}, str(VANE))
    return msgspec.structs.replace(BASE, effects=(term,))


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """The folder after a search for a vane that the list of effects lacks, and what was said."""
    folder = tmp_path_factory.mktemp("own")
    save_model(with_vane(), folder / "hidden.json")
    save_model(BASE, folder / "base.json")
    for number in (1, 2):
        samples, _ = recorded(
            25.0, **SETTINGS, seed=number, craft=str(folder / "hidden.json"), copies=1
        )
        out = RecordingFile(
            folder / f"flight{number}.mcap", {"session": session_metadata("stand-in")}
        )
        out.samples(samples)
        out.finish()
    # The user's own copy: nothing of the hidden craft's files is read.
    (folder / "mine.py").write_text(VANE.read_text())
    done = run_program(
        [
            *(COMMAND, "discrepancy", "flight1.mcap", "--validate", "flight2.mcap"),
            *("--model", "base.json", "--effects", "mine.py"),
            *("-o", "improved.json", "--json", "report.json"),
        ],
        cwd=folder,
        env={**os.environ, "NO_COLOR": "1"},
        timeout=280,
    )
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


def test_the_users_effect_is_named_and_nothing_else(searched):
    folder, said = searched
    report = json.loads((folder / "report.json").read_text())
    assert [effect["name"] for effect in report["effects"]] == ["yaw_weather_vane"]
    found = report["effects"][0]["parameters"]
    for name, true in (("moment", MOMENT), ("lag_s", LAG_S)):
        # The velocity is the search's own, and slow motion is known with a phase that is off.
        assert abs(found[name]["value"] - true) < 0.15 * true
        assert found[name]["stderr"] < 0.1 * true
    assert "1. yaw_weather_vane: yaw +moment s" in said


def test_the_gap_closes_on_the_flight_that_was_held_out(searched):
    folder, _ = searched
    gap = json.loads((folder / "report.json").read_text())["gap"]["channels"]["gyro_z"]
    assert gap["before"] > 1.5 > 1.1 > gap["after"]


def test_the_improved_model_names_the_file_and_simulates(searched):
    folder, _ = searched
    (term,) = load_model(folder / "improved.json").effects
    assert (term.name, Path(term.source)) == ("yaw_weather_vane", folder / "mine.py")
    done = groundstation(
        *("simulate", "--model", "improved.json", "--recording", "flight2.mcap"),
        *("-o", "simulated.csv", "--json"),
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr


def test_a_model_with_ones_own_effect_comes_back_from_the_unknowns():
    (vane,) = own_effects(VANE)
    assert (vane.sizes, vane.keys[1]) == (("yaw_weather_vane.moment",), "yaw_weather_vane.lag_s")
    model = with_vane(2.5, 0.7)
    point = point_of(model)
    assert point["yaw_weather_vane.moment"] == 2.5
    again = model_of(point, {"yaw_weather_vane.lag_s": 0.05}, vane.keys, BASE, own_of(model))
    values = {name: one.value for name, one in again.effects[0].parameters.items()}
    assert values == pytest.approx({"moment": 2.5, "lag_s": 0.7})
    assert again.effects[0].parameters["lag_s"].stderr == pytest.approx(0.05)
    assert again.effects[0].source == str(VANE)


def test_unknowns_are_zero_where_the_effect_is_absent(tmp_path):
    """A factor whose absence is 1, and a shape at its default."""
    path = tmp_path / "factor.py"
    path.write_text(
        VANE.read_text().replace("low=0.1, high=50.0", "low=0.1, high=50.0, absent=1.0")
    )
    (vane,) = own_effects(path)
    assert [one.absent for one in vane.unknowns] == [0.0, 0.0]
    assert vane.unknowns[0].plausible == (-0.9, 49.0)
    values = {name: one.value for name, one in estimates_of(vane, {}, {}).items()}
    assert values == pytest.approx({"moment": 1.0, "lag_s": 0.2})
    assert vane.unknowns[1].bounds == pytest.approx((0.01 - 0.2, 3.0 - 0.2))


def test_a_file_that_is_none_and_an_effect_without_a_size_are_refused(tmp_path):
    with pytest.raises(BadInputError, match="no such file"):
        own_effects(tmp_path / "nowhere.py")
    shapeless = tmp_path / "shapeless.py"
    text = VANE.read_text().replace("high=50.0", 'high=50.0, kind="shape"')
    shapeless.write_text(text)
    with pytest.raises(BadInputError, match="yaw_weather_vane has no size"):
        own_effects(shapeless)


def test_one_name_from_two_files_is_refused(tmp_path):
    other = tmp_path / "other.py"
    other.write_text(VANE.read_text())
    with pytest.raises(BadInputError, match="yaw_weather_vane: defined in"):
        joined(own_effects(VANE), own_effects(other))
