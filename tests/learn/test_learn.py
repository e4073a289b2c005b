"""``learn`` as a user meets it. A whole one is CI's demo stage; here is what may happen on the
way."""

import json
import signal
import subprocess

import numpy as np
import pytest

from groundstation.control.firmware_loop import load_gains
from groundstation.recording.formats import open_recording
from support.daemons import COMMAND, groundstation, in_process, require_failure
from support.findings import PHASES, begun
from support.programs import Program
from support.waiting import until

CRAFT = "software:crazyflie21"
BESIDE = {"learn.json", "log.txt", "commands.sh", "craft.toml", "model.json"}


def learn(folder, link=CRAFT):
    return Program(
        [COMMAND, "learn", "--link", link, "-o", folder],
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
    assert error.endswith("groundstation: interrupted\n")
    return said


def test_ctrl_c_in_a_flight_lands_keeps_what_was_flown_and_it_goes_on_there(tmp_path):
    folder = tmp_path / "learnt"
    log = folder / "learn.json"

    def in_second_flight():
        return log.exists() and any(line.startswith("hover: ") for line in journal(folder)["said"])

    said = interrupted(folder, in_second_flight, "the second flight begins")
    lines = said.splitlines()
    assert "ahead: 9 flights" in said
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


SAYS = {
    "plan": "planning the next flight",
    "search": "$ groundstation discrepancy",
    "design": "designing gains",
    "steps": "flying steps_before.mcap",
}


@pytest.mark.parametrize("phase", PHASES)
def test_ctrl_c_in_a_later_phase_loses_nothing_and_it_goes_on_there(tmp_path, phase):
    folder, link = tmp_path / "learnt", CRAFT
    begun(folder, link, phase)
    before = {path.name: path.read_bytes() for path in folder.glob("[!lc]*")}
    for _ in range(2):
        with learn(folder, link) as program:
            told = []
            for line in program.stdout:
                told.append(line.strip())
                if SAYS[phase] in line:
                    break
            program.send_signal(signal.SIGINT)
            _, error = program.communicate(timeout=100)
        assert program.returncode == 130
        assert error.endswith("groundstation: interrupted\n")
        assert told[2].startswith(SAYS[phase])
        assert {name: (folder / name).read_bytes() for name in before} == before
        made = {path.name for path in folder.iterdir()} - {*before}
        assert all(name.partition(".")[2].startswith("cut") for name in made - BESIDE)


def test_an_axis_that_flies_worse_keeps_its_gains_and_the_others_are_flown_again(tmp_path):
    folder, link = tmp_path / "learnt", CRAFT
    begun(folder, link, "steps")
    lazy_roll, quick_yaw = '"pid_rate.roll_kp" = 90.0', '"pid_rate.yaw_kp" = 240.0'
    (folder / "gains.toml").write_text(f'firmware = "2.x"\n{lazy_roll}\n{quick_yaw}\n')
    ended = groundstation("learn", "--link", link, "-o", folder)
    assert ended.returncode == 0, ended.stderr
    flights = {one["file"]: one["gains"] for one in journal(folder)["flights"]}
    stock, both, kept = (flights[f"steps_{one}.mcap"] for one in ("before", "after1", "after2"))
    assert (both["pid_rate.roll_kp"], both["pid_rate.yaw_kp"]) == (90.0, 240.0)
    assert kept == {**stock, "pid_rate.yaw_kp": 240.0}
    assert journal(folder)["gains"].startswith("written: ")
    assert journal(folder)["gains"].endswith("; roll and pitch as before")
    assert journal(folder)["former"] == {"pid_rate.yaw_kp": stock["pid_rate.yaw_kp"]}
    written = load_gains(folder / "gains.toml")
    assert {k: v for k, v in written.items() if k.startswith("pid_")} == {"pid_rate.yaw_kp": 240.0}


def test_gains_with_which_the_model_does_not_stay_in_its_room_are_not_flown(tmp_path):
    folder, link = tmp_path / "learnt", CRAFT
    begun(folder, link, "steps")
    none = "".join(f'"pid_rate.roll_{part}" = 0.0\n' for part in ("kp", "ki", "kd"))
    (folder / "gains.toml").write_text(f'firmware = "2.x"\n{none}')
    ended = groundstation("learn", "--link", link, "-o", folder)
    assert ended.returncode == 0, ended.stderr
    assert journal(folder)["gains"].startswith("put back: not flown, for the model with them does")
    assert [one["file"] for one in journal(folder)["flights"]][-1] == "steps_before.mcap"
    assert "the limit is" in journal(folder)["gains"] or "is the most" in journal(folder)["gains"]


def software(tmp_path, more):
    path = tmp_path / "mine.toml"
    path.write_text(f'[stand_in]\nplant = "reduced"\ncraft = "crazyflie21"\n{more}\n')
    return f"software:{path}"


def test_an_empty_battery_is_landed_with_and_a_full_one_asked_for_until_there_are_no_more(tmp_path):
    folder, link = tmp_path / "learnt", software(tmp_path, "charge = 0.05")
    ended = groundstation("learn", "--link", link, "-o", folder, "--batteries", 2)
    assert ended.stdout.count("battery 2: put a full one in") == 1
    assert ended.returncode == 1
    assert "2 batteries are flown empty" in ended.stderr
    assert ended.stderr.count(": landing\n") == 2
    flights = journal(folder)["flights"]
    assert [one["battery"] for one in flights] == [1, 2]
    for one in flights:
        assert one["aborted"].startswith("battery below")
        recording = open_recording(folder / one["file"])
        assert "pid fly landing" in [event["text"] for event in recording.events]
        assert not recording.samples.duty[-20:].any()


def test_a_craft_on_its_back_turns_no_motor(tmp_path):
    folder, link = tmp_path / "learnt", software(tmp_path, "upside_down = true")
    assert "on its back" in require_failure(groundstation("learn", "--link", link, "-o", folder))
    assert [one["file"] for one in journal(folder)["flights"]] == ["flight1.cut1.mcap"]


def test_a_disk_that_is_full_is_one_line_and_what_was_flown_before_is_kept(small_disk):
    disk = small_disk("1800k")
    folder = disk / "learnt"
    ended = groundstation("learn", "--link", CRAFT, "-o", folder)
    assert "flight2.mcap: cannot be written: No space left" in require_failure(ended)
    assert [one["file"] for one in journal(folder)["flights"]] == ["flight1.mcap"]
    assert not (folder / "flight2.mcap").exists()
    open_recording(folder / "flight1.mcap")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--space", "wide"], "give two sides"),
        (["--space", "0.5x0.5"], "--space"),
        (["--height", "5"], "--height"),
        (["--hide", "1"], "software"),
        (["--link", "software:zeppelin"], "zeppelin"),
        (["--link", "software:crazyflie1"], "crazyflie21"),
        (["--link", "radio://0/80"], "groundstation run --link radio://0/80"),
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
