"""Batteries that were flown until they were low are remembered, by craft."""

import asyncio

import numpy as np

from groundstation.page.alarms import alarms
from groundstation.service.batteries import FILE, Batteries
from groundstation.service.client import ask
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.packet import encode
from groundstation.telemetry.samples import RawBatch
from support.stations import serve
from support.waiting import until

ROWS = 30_000


def flown(first_v, last_v):
    """A minute of hovering while the voltage falls evenly."""
    none = np.zeros((ROWS, 3), np.int16)
    volts = np.linspace(1e3 * first_v, 1e3 * last_v, ROWS).round()
    packets = encode(
        np.arange(ROWS) * 2000 * 72 // 73, volts, np.full((ROWS, 4), 2400), none, none, none,
        np.zeros(ROWS, np.uint32),
    )  # fmt: skip
    samples, *_ = decode_all(RawBatch(packets, np.arange(ROWS, dtype=np.int64) * 2_000_000))
    return samples


def test_the_next_daemon_knows_how_long_a_battery_of_this_craft_flew(tmp_path):
    told = []

    def batteries(craft):
        return Batteries(tmp_path, lambda: craft, lambda kind, text: told.append(text))

    async def first_daemon():
        craft = batteries("usb crazyflie1")
        assert craft.status() == {"flown_s": 0.0, "left_s": None, "known": 0}
        craft.samples(flown(3.8, 3.1))
        assert craft.status()["left_s"] == (0.0, 0.0)

    asyncio.run(first_daemon())
    again = batteries("usb crazyflie1")
    again.samples(flown(3.8, 3.5)[: ROWS // 2])
    least, most = again.status()["left_s"]
    assert 0 < least < most <= 60
    other = batteries("stand-in crazyflie1")
    other.samples(flown(3.8, 3.5))
    assert other.status()["left_s"] is None
    (tmp_path / FILE).write_text("no JSON")
    assert batteries("usb crazyflie1").status()["known"] == 0
    assert told == []


def test_a_stand_in_whose_battery_is_changed_says_so_and_is_no_alarm(tmp_path):
    config = Config(
        link=LinkConfig(speed=10.0),
        recording=RecordingConfig(folder=str(tmp_path), enabled=False),
        stand_in={"charge": 0.12, "recharge_s": 60.0, "program": "hover"},
    )
    control = tmp_path / "control.sock"

    def conversation(station):
        seen = []

        def back():
            seen.append(ask(control, "GET", "/status"))
            return seen[-1]["link"]["doing"] == "it flies, with battery 2"

        until(back, "the second battery", every_s=0.1)
        pausing = [one for one in seen if one["link"]["pauses"]]
        assert any(one["link"]["state"] == "silent" for one in pausing)
        for one in pausing:
            assert "its battery is changed" in one["link"]["doing"]
            assert {told["level"] for told in alarms(one, "", 3.0)} == {"warning"}
        assert seen[-1]["battery"]["known"] == 1

    serve(config, control, conversation)
    assert (tmp_path / FILE).is_file()
