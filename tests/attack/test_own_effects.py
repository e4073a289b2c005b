"""A model file that brings a program along: nothing of it runs before somebody has consented."""

import json

import msgspec
import pytest

from groundstation.dynamics.craft import CONSENT, consent, craft_of_model, load_effects
from groundstation.dynamics.model import THESIS, load_model
from groundstation.errors import BadInputError
from groundstation.service.config import Config, TwinConfig
from groundstation.service.station import Station
from support.daemons import groundstation, require_failure

PROGRAM = """
from pathlib import Path
from groundstation.dynamics.effect import Effect, Parameter

Path(__file__).with_name("has_run").touch()

def law(values, craft, body):
    return (-values[0] * body.rate[0], 0.0, 0.0), (0.0, 0.0, 0.0)

EVIL = Effect("evil", "body", (Parameter("d", "1/s", 0.1, 0.0, 1.0),), "", "", "", ("gyro x",),
              law=law)
"""


@pytest.fixture
def model(tmp_path, monkeypatch):
    """A model whose effect would leave a mark when its file is run."""
    monkeypatch.delenv(CONSENT)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    load_effects.cache_clear()
    (tmp_path / "mine.py").write_text(PROGRAM)
    content = msgspec.to_builtins(THESIS)
    content["effects"] = [
        {"name": "evil", "source": "mine.py", "parameters": {"d": {"value": 0.1}}}
    ]
    path = tmp_path / "model.json"
    path.write_text(json.dumps(content))
    return path


def test_simulate_names_the_file_and_the_way(model, tmp_path):
    line = require_failure(
        groundstation(
            "simulate", "--model", model, "--reference", "hover", "-o", tmp_path / "a.csv"
        )
    )
    assert "mine.py" in line
    assert "--trust-effects" in line
    assert not (tmp_path / "has_run").exists()


def test_consent_is_asked_once_for_each_content(model, tmp_path, monkeypatch):
    source = tmp_path / "mine.py"
    monkeypatch.setenv(CONSENT, "1")
    load_effects(source)
    monkeypatch.delenv(CONSENT)
    load_effects.cache_clear()
    assert "evil" in load_effects(source), "it is known now"
    with source.open("a") as file:
        file.write("# another content\n")
    load_effects.cache_clear()
    with pytest.raises(BadInputError, match="--trust-effects"):
        load_effects(source)


@pytest.mark.parametrize(
    "fly",
    [
        lambda path: craft_of_model(load_model(path)),
        lambda path: Station(Config(twin=TwinConfig(model=str(path)))),
    ],
    ids=["the stand-in and predictions", "the live twin"],
)
def test_who_flies_such_a_model_asks_first(model, fly):
    with pytest.raises(BadInputError, match="--trust-effects"):
        fly(model)
    assert not model.with_name("has_run").exists()


def test_a_file_that_the_user_names_is_consent_for_this_file_only(model, tmp_path, monkeypatch):
    monkeypatch.setenv(CONSENT, "")  # restored, whatever is put there
    other = tmp_path / "other.py"
    other.write_text(PROGRAM + "# another\n")
    consent(other)
    assert "evil" in load_effects(other)
    with pytest.raises(BadInputError, match="--trust-effects"):
        load_effects(tmp_path / "mine.py")
