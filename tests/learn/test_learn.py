"""``learn`` as a user meets it. A whole one is CI's demo stage; here is what may happen on the
way."""

import json
import signal
import subprocess

import numpy as np
import pytest

from groundstation.recording.open_recording import open_recording
from support.daemons import COMMAND, in_process, require_failure
from support.programs import Program
from support.waiting import until

CRAFT = "software:crazyflie21"


def learn(folder, *more):
    return Program(
        [COMMAND, "learn", "--link", CRAFT, "-o", folder, *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def journal(folder):
    return json.loads((folder / "learn.json").read_text())


def interrupted(folder, when, what):
    """Ctrl-C in the phase that ``when`` tells; what was said."""
    with learn(folder) as program:
        until(when, what, timeout_s=200.0)
        program.send_signal(signal.SIGINT)
        said, error = program.communicate(timeout=100)
    assert program.returncode == 130
    assert error == "groundstation: interrupted\n"
    return said


def test_ctrl_c_in_a_flight_stops_the_motors_keeps_what_was_flown_and_it_goes_on_there(tmp_path):
    folder = tmp_path / "learnt"
    log = folder / "learn.json"

    def in_second_flight():
        return log.exists() and any(line.startswith("hover: ") for line in journal(folder)["said"])

    said = interrupted(folder, in_second_flight, "the second flight begins")
    lines = said.splitlines()
    assert "ahead: 7 flights" in said
    assert lines.index(next(one for one in lines if one.startswith("ahead"))) < lines.index(
        next(one for one in lines if one.startswith("flying"))
    )
    assert journal(folder)["flights"][0]["file"] == "flight1.mcap"
    for one in journal(folder)["flights"]:
        assert not open_recording(folder / one["file"]).samples.duty[-20:].any()

    fitting = folder / "commands.sh"
    said = interrupted(
        folder,
        lambda: "fit body" in (folder / "log.txt").read_text(),
        "the body is fitted",
    )
    assert "flying flight1.mcap" not in said
    assert "flying flight2.mcap" in said
    assert fitting.exists()
    flights = journal(folder)["flights"]
    assert [one["file"] for one in flights if not one["aborted"]] == [
        "flight1.mcap",
        "flight2.mcap",
    ]
    assert np.isfinite(open_recording(folder / "flight2.mcap").samples.gyro).all()

    line = require_failure(in_process("learn", "--link", CRAFT, "-o", folder, "--height", "0.8"))
    assert "begun with other options" in line


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--space", "wide"], "give two sides"),
        (["--space", "0.5x0.5"], "--space"),
        (["--height", "5"], "--height"),
        (["--hide", "1"], "software"),
        (["--link", "software:zeppelin"], "zeppelin"),
        (["--undo"], "nothing to put back"),
    ],
)
def test_what_cannot_be_is_one_line_and_no_folder(tmp_path, options, reason):
    line = require_failure(in_process("learn", "-o", tmp_path / "learnt", *options))
    assert reason in line
    assert not (tmp_path / "learnt").exists()


def test_a_folder_with_something_in_it_is_refused_and_left_alone(tmp_path):
    (tmp_path / "mine").write_text("precious")
    line = require_failure(in_process("learn", "--link", CRAFT, "-o", tmp_path))
    assert "not an empty folder" in line
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
