"""Files that others wrote, given where the program reads its own: pipes, devices, nested depths."""

import json
import os
from pathlib import Path

import pytest

from firmware_sim.programme import load_programme
from firmware_sim.settings import load_settings
from groundstation.control.firmware_loop import load_gains
from groundstation.documents import DEPTH_MOST, decode_json, decode_toml
from groundstation.dynamics.craft import load_effects
from groundstation.dynamics.model import load_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import RecordingError
from groundstation.prediction.prediction import load_reference
from groundstation.recording.map_document import load_column_map
from groundstation.recording.mcap_schemas import decode_entry
from groundstation.service.config import load_config

JSON_READERS = {"model": load_model}
TOML_READERS = {
    "vehicle": load_vehicle,
    "gains": load_gains,
    "configuration": load_config,
    "column map": load_column_map,
    "stand-in settings": load_settings,
    "pilot programme": lambda path: load_programme(str(path)),
}
READERS = {
    **JSON_READERS,
    **TOML_READERS,
    "reference": lambda path: load_reference(str(path)),
    "effects": load_effects,
}
REFUSED = (ValueError, RecordingError)

pytestmark = pytest.mark.timeout(20)


@pytest.mark.parametrize("reader", READERS)
def test_a_pipe_or_a_device_is_refused_at_once(tmp_path, reader):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero"), tmp_path):
        with pytest.raises(REFUSED, match=r"(?i)not a regular file|directory|nor a file"):
            READERS[reader](path)


@pytest.mark.parametrize("reader", TOML_READERS)
@pytest.mark.parametrize("text", ["a = " + "[" * 5000, "a." * 20_000 + "a = 1"])
def test_toml_nested_without_end_is_refused_in_words(tmp_path, reader, text):
    path = tmp_path / "deep.toml"
    path.write_text(text)
    with pytest.raises(REFUSED, match="nested deeper than"):
        TOML_READERS[reader](path)


@pytest.mark.parametrize("depth", [200, 5000])
def test_a_model_nested_without_end_is_refused_in_words(tmp_path, depth):
    path = tmp_path / "deep.json"
    path.write_text('{"fit": ' + '{"a":' * depth + "1" + "}" * depth + "}")
    with pytest.raises(ValueError, match="nested deeper than"):
        load_model(path)


def test_an_entry_of_a_foreign_recording_nested_without_end_is_damage_and_no_crash():
    with pytest.raises(ValueError, match="nested deeper than"):
        decode_entry(b'{"details":' + b"[" * 900 + b"]" * 900 + b"}")


def test_a_number_of_too_many_digits_is_refused_in_words(tmp_path):
    path = tmp_path / "long.toml"
    path.write_text("a = " + "1" * 5000)
    with pytest.raises(ValueError, match="digits"):
        load_gains(path)


def test_depth_is_counted_in_brackets_not_in_strings():
    brackets = "[" * 100
    assert decode_json(json.dumps({"text": '\\"' + brackets}).encode(), dict)["text"] == (
        '\\"' + brackets
    )
    flat = [[1]] * 100
    assert decode_json(json.dumps(flat).encode(), list) == flat
    deepest = "[" * DEPTH_MOST + "]" * DEPTH_MOST
    assert json.dumps(decode_json(deepest.encode(), list)) == deepest
    assert decode_toml(b'text = "a.b.c' + b".d" * 100 + b'"', dict)["text"].count(".") == 102
