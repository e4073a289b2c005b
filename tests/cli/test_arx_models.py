"""A model file with ARX polynomials flies: they turn the craft, its body carries it."""

import json

import msgspec
import pytest

from groundstation.dynamics.model import load_model, save_model
from groundstation.errors import BadInputError
from groundstation.recording.csv_file import write_csv
from groundstation.recording.session import Recording
from support.commands import run
from support.flights import recorded


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A flight of a craft that is 6 ms late, a body fitted without delay, ARX models of both."""
    folder = tmp_path_factory.mktemp("arx")
    late = {"effects": {"dead_time": {"delay_s": 0.006}}}
    samples, _ = recorded(40.0, seed=5, plant="reduced", **late)
    write_csv(Recording(folder / "flight.csv", "csv", samples), folder / "flight.csv")
    found = {name: folder / name for name in ("flight.csv", "body.json", "rates.json", "four.json")}
    run("fit", "body", found["flight.csv"], "-o", found["body.json"])
    rates = ("fit", "arx", found["flight.csv"], "--model", found["body.json"], "--gyro")
    run(*rates, "-o", found["rates.json"])
    run(*rates, "--decimate", 4, "-o", found["four.json"])
    return found


def document(text):
    return json.loads(text[text.index("{") :])


def compared(files, model, *more):
    return document(run("compare", files["flight.csv"], "--model", files[model], "--json", *more))


def test_compare_flies_the_polynomials_with_their_delay(files):
    by_arx = compared(files, "four.json")
    by_body = compared(files, "four.json", "--attitude", "body")
    assert (by_arx["attitude"], by_body["attitude"]) == ("arx", "body")
    for axis in ("gyro_x", "gyro_y"):
        gaps = [one["gap"]["channels"][axis]["before"] for one in (by_arx, by_body)]
        assert gaps[0] < 0.8 * gaps[1]
    thrust = [one["gap"]["channels"]["accelerometer_z"]["before"] for one in (by_arx, by_body)]
    assert thrust[0] == thrust[1]


def test_simulate_says_what_turns_the_craft_and_follows_the_flight(files, tmp_path):
    common = ("simulate", "--recording", files["flight.csv"], "--model", files["rates.json"])
    text = run(*common, "-o", tmp_path / "arx.csv", "--json")
    assert "the craft turns by roll ARX(" in text
    body = document(run(*common, "-o", tmp_path / "body.csv", "--attitude", "body", "--json"))
    arx = document(text)
    for axis in ("roll_deg", "pitch_deg"):
        assert arx["rms"][axis] < body["rms"][axis] < 3.0


def test_polynomials_without_a_body_say_what_they_cannot_do(files, tmp_path):
    alone = msgspec.structs.replace(load_model(files["rates.json"]), body=None)
    save_model(alone, tmp_path / "alone.json")
    model = ("--model", tmp_path / "alone.json")
    for command in (
        ("simulate", *model, "--recording", files["flight.csv"], "-o", tmp_path / "x.csv"),
        ("compare", files["flight.csv"], *model),
    ):
        with pytest.raises(BadInputError, match="only ARX polynomials: thrust, and when the craft"):
            run(*command)


def test_polynomials_that_are_not_there_cannot_be_asked_for(files):
    command = ("compare", files["flight.csv"], "--model", files["body.json"], "--attitude", "arx")
    with pytest.raises(BadInputError, match="of none, all of roll, pitch, yaw are needed"):
        run(*command)
