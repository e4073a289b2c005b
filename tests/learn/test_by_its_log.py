"""``learn`` of a craft whose log is the link: cflib over UDP carries telemetry and commands."""

import json
import signal
from functools import partial

import pytest

from groundstation.control.firmware_loop import load_gains
from groundstation.service.client import ask
from support.commands import Beside, connected, software_craft
from support.daemons import Daemon
from support.findings import begun
from support.programs import LONGEST_S, free_port
from support.waiting import in_real_time, until

CRAFT = 'plant = "reduced"\ncraft = "crazyflie21"\nprogram = "wait"\nflow_deck = true\nseed = 3\n'
BETTER = {
    f"pid_{loop}.{axis}_{gain}": value
    for axis in ("roll", "pitch")
    for loop, gain, value in (
        ("rate", "kp", 223.3), ("rate", "ki", 94.4), ("rate", "kd", 3.262),
        ("attitude", "kp", 11.22), ("attitude", "ki", 5.575),
    )
}  # fmt: skip
"""As ``learn`` designs them for such a craft."""


@pytest.fixture
def craft(tmp_path):
    """That has just been switched on, and where it is heard."""
    uri = f"127.0.0.1:{free_port()}"
    with software_craft(tmp_path, CRAFT, "--crtp", uri) as running:
        yield running, uri


@pytest.fixture
def daemon(craft, tmp_path):
    with Daemon(tmp_path, "--link", f"udp://{craft[1]}", "--recordings", "sessions") as running:
        running.status_when(connected, "the craft is there")
        yield running


@pytest.mark.parametrize("ends", ["killed", "not heard any more"])
def test_gains_of_which_a_flight_was_cut_short_fly_again_are_written_and_put_back(
    craft, daemon, tmp_path, ends
):
    folder = tmp_path / "learnt"
    craft_is = ask(daemon.socket, "GET", "/status")["command"]["craft"]
    begun(folder, "daemon", "steps", craft_is)
    lines = [f'"{name}" = {value}' for name, value in BETTER.items()]
    (folder / "gains.toml").write_text("\n".join(['firmware = "2.x"', *lines]))

    beside = Beside(daemon)
    learn = partial(beside.begun, "learn", "--yes", "-o", folder)

    def of_the_craft():
        return {k: value for k, value in beside.gains().items() if k.startswith("pid_")}

    def programmes():
        return beside.events("mark").count("pid fly programme")

    def what_came_of_it():
        return json.loads((folder / "learn.json").read_text())["gains"]

    before = of_the_craft()
    with learn() as cut:
        with in_real_time():
            until(lambda: programmes() == 2 or cut.poll() is not None, "it flies", LONGEST_S)
            assert cut.poll() is None, cut.communicate()[1]
        if ends == "killed":
            cut.kill()
            cut.communicate(timeout=LONGEST_S)
        else:
            craft[0].send_signal(signal.SIGSTOP)
            _, error = cut.communicate(timeout=LONGEST_S)
            craft[0].send_signal(signal.SIGCONT)
            assert cut.returncode == 1
            assert "flight cut short" in error
            daemon.status_when(connected, "the craft is heard again")
    assert what_came_of_it() == ""
    until(lambda: of_the_craft() == before, "the daemon has put the former gains back")
    with learn() as learns:
        _, error = learns.communicate(timeout=LONGEST_S)
    assert learns.returncode == 0, error
    assert what_came_of_it().startswith("written: ")
    written = load_gains(folder / "gains.toml")  # without an axis that overshot by too much
    assert written
    assert written.items() <= BETTER.items()
    kept = {name: written.get(name, before[name]) for name in BETTER}
    assert {name: of_the_craft()[name] for name in BETTER} == pytest.approx(kept, rel=1e-6)
    with learn("--undo") as undoes:
        _, error = undoes.communicate(timeout=LONGEST_S)
    assert undoes.returncode == 0, error
    assert of_the_craft() == before
