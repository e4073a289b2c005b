"""``groundstation motors``: what it asks the daemon for, whom it asks first, and what it says."""

import json

import pytest

from support.daemons import in_process, require_failure
from support.page_requests import answering


@pytest.fixture
def control(tmp_path):
    return tmp_path / "control.sock"


def ended(motors, *kinds):
    return {"motors": motors, "ended": list(kinds), "done": True}


@pytest.mark.parametrize(
    ("word", "done"), [("stop", "stopped"), ("land", "landed"), ("land", "stopped")]
)
def test_it_says_what_became_of_the_motors_and_what_else_was_ended(control, word, done):
    route = f"POST /command/{word}"
    with answering(control, answers := {route: ended(done)}) as asked:
        said = in_process("motors", word, socket_path=control)
        assert (said.returncode, said.stdout) == (0, f"{done}; nobody is in control now\n")
        answers[route] = ended(done, "learn")
        said = in_process("motors", word, socket_path=control)
        assert said.stdout == f"{done}; learn was ended; nobody is in control now\n"
        said = in_process("motors", word, "--json", socket_path=control)
        assert json.loads(said.stdout) == {"motors": done, "ended": ["learn"]}
        answers[route] = ended("asked to stop, motors still turn", "learn")
        line = require_failure(in_process("motors", word, socket_path=control))
        assert "motors still turn; learn was ended" in line
    assert asked == [route] * 4


@pytest.mark.parametrize(
    ("uri", "asks"),
    [
        ("radio://0/80/2M/E7E7E7E7E7", True),
        ("udp://192.0.2.1:2390", True),  # a craft on a wireless network
        ("udp://127.0.0.1:19850", False),
    ],
)
def test_a_real_craft_is_armed_after_a_yes_only(control, uri, asks):
    answers = {"GET /status": {"command": {"uri": uri}}, "POST /command/arm": {"done": True}}
    with answering(control, answers) as asked:
        said = in_process("motors", "arm", socket_path=control)
        assert (said.returncode != 0) is asks
        assert ("POST /command/arm" in asked) is not asks
        assert in_process("motors", "arm", "--yes", socket_path=control).stdout == "armed\n"
