"""A command link that is connected while the daemon runs, and what it may reach."""

import json
import socket
from functools import partial

import pytest

from groundstation.errors import GroundStationError
from groundstation.service.client import Pilot, ask
from groundstation.service.config import Config, RecordingConfig
from support.daemons import in_process
from support.programs import free_port
from support.waiting import until
from support.worlds import serve


@pytest.fixture
def talk(tmp_path, path):
    """talk(conversation): with a station that was given no command link."""
    config = Config(recording=RecordingConfig(folder=str(tmp_path), enabled=False))
    asked = partial(ask, path)

    def streaming(conversation):
        until(lambda: asked("GET", "/status")["link"]["state"] == "streaming", "the craft")
        conversation(asked, path)

    return lambda conversation: serve(config, path, lambda station: streaming(conversation))


def connected(ask):
    command = ask("GET", "/status")["command"]
    return command is not None and command["state"] == "connected"


def test_a_stand_in_is_commanded_at_the_address_that_was_asked_for(talk):
    def conversation(ask, path):
        assert ask("GET", "/status")["command"] is None
        for _ in range(2):
            uri = f"udp://127.0.0.1:{free_port()}"
            assert ask("POST", "/command/connect", {"uri": uri})["command"]["uri"] == uri
            until(lambda: connected(ask), "the command link")
        with Pilot(path, "a program") as pilot:
            pilot.setpoint(0.0, 0.0, 0.0, 0)
            with pytest.raises(GroundStationError, match="a program is commanding"):
                ask("POST", "/command/connect", {"uri": uri})
        with pytest.raises(GroundStationError, match="knows no arming"):
            ask("POST", "/command/arm", {"on": True})

    talk(conversation)


@pytest.mark.parametrize(
    ("uri", "says"),
    [
        ("serial:/dev/ttyUSB0", "radio://"),
        ("radio://0/80/2M", "the stand-in answers at udp://"),
        ("udp://127.0.0.1:{taken}", "command port"),
    ],
)
def test_another_address_is_refused_and_nothing_changes(talk, uri, says):
    def conversation(ask, path):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.0.1", 0))
            asked = {"uri": uri.format(taken=other.getsockname()[1])}
            with pytest.raises(GroundStationError, match=says):
                ask("POST", "/command/connect", asked)
        assert ask("GET", "/status")["command"] is None
        with pytest.raises(GroundStationError, match="no command link"):
            ask("POST", "/command/arm", {"on": True})

    talk(conversation)


def test_what_is_plugged_in_is_told_as_the_command_tells_it(talk):
    def conversation(ask, path):
        told = json.loads(in_process("devices", "--json").stdout)
        assert ask("GET", "/devices") == told

    talk(conversation)
