"""No flight begins on a battery that is nearly empty: ``pid fly`` looks before a rotor turns."""

import pytest

from groundstation.service.client import ask
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from support import ROOT
from support.daemons import in_process, require_failure
from support.programs import free_port
from support.stations import serve
from support.waiting import until

GAINS = ROOT / "tests" / "control" / "data" / "gains.toml"
CHARGE = 0.057
"""Of a cell that shows 3.44 V at rest; 3.5 V is the least."""


def test_a_flight_is_refused_below_three_and_a_half_volts_at_rest(tmp_path):
    path = tmp_path / "control.sock"
    config = Config(
        link=LinkConfig(name="stand-in"),
        stand_in={"program": "wait", "charge": CHARGE, "land_when_low": False},
        command=f"udp://127.0.0.1:{free_port()}",
        recording=RecordingConfig(folder=str(tmp_path / "sessions"), enabled=False),
    )

    def refused(station):
        until(
            lambda: ask(path, "GET", "/status")["command"]["state"] == "connected",
            "the command link is connected",
        )
        flight = in_process("pid", "fly", "--gains", GAINS, "--yes", socket_path=path, cwd=tmp_path)
        craft = station.receiver.link._craft.state()
        assert max(craft.motors) == pytest.approx(0.0)
        return flight

    line = require_failure(serve(config, path, refused))
    assert "battery at 3.4" in line
    assert "3.5 V at rest is the least; charge it" in line
