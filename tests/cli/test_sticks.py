"""A human's thrust: keys of a terminal, events of the kernel's joystick interface."""

import os
import pty
import struct
import subprocess
import sys

import pytest

from groundstation.cli.pid_fly import Gamepad, Keyboard, StandInPilot, height_of, open_sticks
from groundstation.errors import BadInputError
from support.programs import Program

AXIS, BUTTON, INITIAL = 2, 1, 0x80


def event(kind, number, value):
    return struct.pack("<IhBB", 0, value, kind, number)


@pytest.fixture
def pad(tmp_path):
    """(gamepad, file descriptor that feeds it)"""
    path = tmp_path / "js0"
    os.mkfifo(path)
    feeding = os.open(path, os.O_RDWR)
    with Gamepad(path) as gamepad:
        yield gamepad, feeding
    os.close(feeding)


def test_a_gamepad_at_rest_gives_nothing(pad):
    gamepad, feeding = pad
    os.write(feeding, b"".join(event(AXIS | INITIAL, n, 500) for n in range(5)))
    hands = gamepad.read()
    assert (hands.thrust, hands.roll_deg, hands.pitch_deg, hands.yaw_dps) == (0, 0.0, 0.0, 0.0)
    assert not hands.begin
    assert not hands.stop


def test_sticks_lean_the_craft_the_way_they_are_pushed(pad):
    gamepad, feeding = pad
    right, ahead, up, left = (3, 32767), (4, -32767), (1, -32767), (0, -32767)
    os.write(feeding, b"".join(event(AXIS, *one) for one in (right, ahead, up, left)))
    hands = gamepad.read()
    assert hands.roll_deg == pytest.approx(15.0)  # right side down
    assert hands.pitch_deg == pytest.approx(15.0)  # nose down
    assert hands.yaw_dps == pytest.approx(90.0)  # counter-clockwise
    assert hands.thrust == 55000


def test_a_torn_event_waits_for_its_rest(pad):
    gamepad, feeding = pad
    whole = event(AXIS, 1, -32767)
    os.write(feeding, whole[:3])
    assert gamepad.read().thrust == 0
    os.write(feeding, whole[3:])
    assert gamepad.read().thrust == 55000


def test_buttons_begin_and_stop_and_a_stop_lasts(pad):
    gamepad, feeding = pad
    os.write(feeding, event(BUTTON, 0, 1) + event(BUTTON, 0, 0) + event(AXIS, 1, -30000))
    assert gamepad.read().begin
    os.write(feeding, event(BUTTON, 1, 1) + event(BUTTON, 1, 0))
    hands = gamepad.read()
    assert hands.stop
    assert hands.thrust == 0


def test_keys_raise_lower_begin_and_stop():
    """In a process of its own, whose terminal is a pseudo-terminal."""
    script = (
        "import time\n"
        "from groundstation.cli.pid_fly import Keyboard\n"
        "with Keyboard() as keys:\n"
        "    print('ready', flush=True)\n"
        "    while not (hands := keys.read()).begin: time.sleep(0.01)\n"
        "    print(hands.thrust, flush=True)\n"
        "    while not (hands := keys.read()).stop: time.sleep(0.01)\n"
        "    print(hands.thrust, flush=True)\n"
    )
    ours, theirs = pty.openpty()
    with Program(
        [sys.executable, "-c", script], stdin=theirs, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "ready\n"
        os.write(ours, b"WWwwsg")
        assert process.stdout.readline() == "5500\n"
        os.write(ours, b" ")
        assert process.stdout.readline() == "0\n"
    os.close(ours)
    os.close(theirs)


def test_the_stand_ins_pilot_is_always_ready():
    hands = open_sticks("stand-in").read()
    assert hands.begin
    assert hands.thrust > 10000
    assert isinstance(open_sticks("stand-in"), StandInPilot)


def test_what_is_no_source_of_thrust_is_refused(tmp_path):
    with pytest.raises(BadInputError, match="there are stand-in"):
        open_sticks("autopilot")
    with pytest.raises(BadInputError, match="No such file"):
        open_sticks(f"gamepad:{tmp_path / 'js9'}")
    if not sys.stdin.isatty():
        with pytest.raises(BadInputError, match="no terminal"):
            Keyboard()


def test_a_height_is_no_stick_and_is_one_that_a_room_has():
    assert height_of("height:0.6") == 0.6
    assert height_of("height") == 0.5
    assert height_of("keyboard") is None
    for wrong in ("height:0.1", "height:3", "height:up", "height:nan"):
        with pytest.raises(BadInputError, match=r"give metres, 0\.2\.\.2"):
            height_of(wrong)
