"""A Stop that is pressed while a program is still being loaded ends it as any other."""

import time

import pytest

from groundstation.cli import main
from groundstation.cli.flying import stops_begun
from groundstation.errors import GroundStationError
from groundstation.service.client import ask
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from support.programs import free_port
from support.stations import serve
from support.waiting import until


def test_a_program_that_was_loaded_while_somebody_pressed_stop_does_not_begin(
    tmp_path, monkeypatch
):
    path = tmp_path / "control.sock"
    config = Config(
        link=LinkConfig(name="stand-in"),
        stand_in={"program": "wait"},
        command=f"udp://127.0.0.1:{free_port()}",
        recording=RecordingConfig(folder=str(tmp_path / "sessions"), enabled=False),
    )

    def begun(station):
        until(
            lambda: ask(path, "GET", "/status")["command"]["state"] == "connected",
            "the command link is connected",
        )
        monkeypatch.setattr(main, "begun_ns", time.time_ns())
        before = stops_begun(path)
        ask(path, "POST", "/command/stop")
        with pytest.raises(GroundStationError, match="stopped since this program began"):
            stops_begun(path)
        monkeypatch.setattr(main, "begun_ns", time.time_ns())
        return before, stops_begun(path)

    before, after = serve(config, path, begun)
    assert after == before + 1
