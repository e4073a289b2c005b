"""What is said of a document with a slip in it, or of one that was taken for another."""

from __future__ import annotations

import pytest

from groundstation.control.firmware_loop import load_gains
from groundstation.dynamics.model import load_model, save_model
from groundstation.errors import BadInputError
from groundstation.paths import taken
from groundstation.recording.formats import open_recording
from groundstation.service.config import load_config


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('viewer.mode = "red"', "there are off, serve, spawn"),
        ("[stand_inn]", "did you mean stand_in?"),
        ("[viewer]\nwarp = 9", "there are mode, "),
        ('link.speed = "fast"', "there are max"),
    ],
)
def test_a_slip_in_the_configuration_is_told_with_what_there_is(tmp_path, text, told):
    path = tmp_path / "station.toml"
    path.write_text(text)
    with pytest.raises(BadInputError) as error:
        load_config(path)
    assert told in str(error.value)


def test_gains_and_models_that_were_swapped_are_told_apart(tmp_path):
    gains, model = tmp_path / "gains.toml", tmp_path / "body.json"
    gains.write_text("[roll]\nkp = 1.0\nki = 0.0\nkd = 0.0\n")
    save_model(load_model("thesis"), model)
    with pytest.raises(BadInputError, match=r"looks like TOML .*--gains"):
        load_model(gains)
    with pytest.raises(BadInputError, match="looks like a model file, for --model"):
        load_gains(model)
    with pytest.raises(BadInputError, match="not a recording; it looks like a model file"):
        open_recording(model)


def test_a_taken_name_comes_with_the_next_free_one(tmp_path):
    for name in ("flight.mcap", "flight-2.mcap"):
        (tmp_path / name).touch()
    assert taken(tmp_path / "flight.mcap").endswith("flight-3.mcap is free")
