"""Models that jobs have left beside the recordings: what is told of them, and what flies."""

from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.model import THESIS, EffectTerm, Estimate, save_model
from groundstation.errors import GroundStationError
from groundstation.identification.estimate import Estimates
from groundstation.service.client import ask
from groundstation.service.config import Config, RecordingConfig
from groundstation.service.jobs import Job
from support.programs import free_port
from support.waiting import until
from support.worlds import serve

FIT = "2026-11-22T20-00-00-000Z_fit"
BROKEN = "2026-11-22T20-00-01-000Z_fit"
C0, STDERR = THESIS.body.c0, 1e-4


def fitted():
    """As a fit of c0 writes it, with a dead time found along, and c2 changed by hand later."""
    estimates = Estimates(("c0", "c2"), np.array([C0, 9.0]), np.diag([STDERR**2, 1.0]), 9000.0)
    term = EffectTerm("dead_time", {"delay_s": Estimate(0.004, 0.0002, "s")})
    return msgspec.structs.replace(
        THESIS,
        effects=(term,),
        origin={"motor": "profile", "body": "fitted"},
        fit={"body": {"estimates": estimates.as_dict(), "warnings": ["too short"]}},
    )


@pytest.fixture
def talk(tmp_path, path):
    """talk(conversation): with a station whose folder holds two jobs of an earlier daemon."""
    folder = tmp_path / "sessions" / "jobs"
    for name in (FIT, BROKEN):
        (folder / name).mkdir(parents=True)
        job = Job(id=name, kind="fit", recordings=["a.mcap"], validate=["b.mcap"], state="done")
        (folder / name / "job.json").write_bytes(msgspec.json.encode(job))
    save_model(fitted(), folder / FIT / "model.json")
    (folder / BROKEN / "model.json").write_text("{}")
    config = Config(
        recording=RecordingConfig(folder=str(folder.parent), enabled=False),
        command=f"udp://127.0.0.1:{free_port()}",
    )
    asked = partial(ask, path)
    return lambda conversation: serve(config, path, lambda station: conversation(asked))


def test_models_are_listed_with_what_is_known_of_their_numbers(talk):
    thesis, model, broken = talk(lambda ask: ask("GET", "/models"))
    assert (thesis["id"], thesis["kind"], thesis["file"]) == ("thesis", "built-in", None)
    assert (model["id"], model["recordings"], model["validate"]) == (FIT, ["a.mcap"], ["b.mcap"])
    assert model["effects"] == ["dead_time"]
    assert "too short" in model["notes"]
    numbers = {one["name"]: one for one in model["parameters"]}
    c0, c2, a0 = (numbers[name] for name in ("body.c0", "body.c2", "motor.a0"))
    assert (c0["low"], c0["high"]) == pytest.approx((C0 - 1.96 * STDERR, C0 + 1.96 * STDERR))
    assert c2["low"] is None  # the account speaks of another value
    assert (a0["low"], a0["origin"]) == (None, "profile")
    b1 = numbers["arx.roll.b1"]
    assert (b1["unit"], b1["low"]) == ("rad per (rev/s)²", None)  # printed by the thesis
    delay = numbers["dead_time.delay_s"]
    assert (delay["low"], delay["high"]) == pytest.approx((0.003608, 0.004392))
    assert all(one["unit"] and one["meaning"] for one in numbers.values())
    assert "not a model file" in broken["problem"]


def test_a_model_is_flown_by_the_stand_in_and_watches_the_craft(talk):
    def connected(ask):
        return ask("GET", "/status")["command"]["state"] == "connected"

    def conversation(ask):
        until(lambda: connected(ask), "the command link")
        status = ask("POST", "/link", {"name": f"stand-in:{FIT}"})
        assert status["link"]["name"] == f"stand-in:{FIT}"
        until(lambda: connected(ask), "the command link of the craft that took over")
        until(lambda: ask("GET", "/status")["link"]["doing"], "what it does")
        watched = ask("POST", "/models/watch", {"model": FIT})["twin"]["model"]
        assert Path(watched).parent.name == FIT
        assert ask("POST", "/models/watch", {"model": ""})["twin"] is None
        assert ask("POST", "/link", {"name": "stand-in"})["link"]["name"] == "stand-in"
        for path, body, says in (
            ("/link", {"name": "stand-in:/etc/passwd"}, "no such model"),
            ("/link", {"name": f"stand-in:{BROKEN}"}, "not a model file"),
            ("/models/watch", {"model": "nothing"}, "no such model"),
            ("/models/watch", {"model": BROKEN}, "not a model file"),
        ):
            with pytest.raises(GroundStationError, match=says):
                ask("POST", path, body)
        until(lambda: connected(ask), "the command link, after a craft that could not take over")
        with pytest.raises(GroundStationError, match="stand-in is the link already"):
            ask("POST", "/link", {"name": "stand-in"})
        assert connected(ask), "a refused switch costs nobody the command link"

    talk(conversation)
