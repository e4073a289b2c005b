"""What a program looks at before its first motor turns: a battery that is nearly empty, and a Stop
that was pressed while it was still being loaded."""

import time

import pytest

from groundstation.cli import main
from groundstation.cli.flying import stops_begun
from groundstation.errors import GroundStationError
from groundstation.service.client import ask
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from support import ROOT
from support.daemons import in_process, require_failure
from support.programs import free_port
from support.waiting import until
from support.worlds import serve

GAINS = ROOT / "tests" / "control" / "data" / "gains.toml"
CHARGE = 0.057
"""Of a cell that shows 3.44 V at rest; 3.5 V is the least."""


@pytest.fixture
def beside(tmp_path):
    """beside(conversation, **craft): what it gives beside a station that commands a craft."""

    def begin(conversation, **craft):
        config = Config(
            link=LinkConfig(name="stand-in"),
            stand_in={"program": "wait", **craft},
            command=f"udp://127.0.0.1:{free_port()}",
            recording=RecordingConfig(folder=str(tmp_path / "sessions"), enabled=False),
        )
        path = tmp_path / "control.sock"

        def connected(station):
            until(
                lambda: ask(path, "GET", "/status")["command"]["state"] == "connected",
                "the command link is connected",
            )
            return conversation(station, path)

        return serve(config, path, connected)

    return begin


def test_a_flight_is_refused_below_three_and_a_half_volts_at_rest(tmp_path, beside):
    def refused(station, path):
        flight = in_process("pid", "fly", "--gains", GAINS, "--yes", socket_path=path, cwd=tmp_path)
        craft = station.receiver.link._craft.state()
        assert max(craft.motors) == pytest.approx(0.0)
        return flight

    line = require_failure(beside(refused, charge=CHARGE, land_when_low=False))
    assert "battery at 3.4" in line
    assert "3.5 V at rest is the least; charge it" in line


def test_a_program_that_was_loaded_while_somebody_pressed_stop_does_not_begin(beside, monkeypatch):
    def begun(_, path):
        monkeypatch.setattr(main, "begun_ns", time.time_ns())
        before = stops_begun(path)
        ask(path, "POST", "/command/stop")
        with pytest.raises(GroundStationError, match="stopped since this program began"):
            stops_begun(path)
        monkeypatch.setattr(main, "begun_ns", time.time_ns())
        return before, stops_begun(path)

    before, after = beside(begun)
    assert after == before + 1
