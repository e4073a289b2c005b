"""The USB link under the contract of every link, and one flight through it."""

import asyncio

import numpy as np
import pytest
from emulated_bridge import OUT, EmulatedBridge, RecordedFlight, open_when_there, unpacked

from groundstation.links.factory import make_link
from groundstation.links.usb import UsbLink
from support.links import LinkContract, packets_read


class TestUsb(LinkContract):
    bad = (
        ("usb", {"device": "0483"}, "VID:PID"),
        ("usb", {"device": "zzzz:5741"}, "zzzz:5741"),
        ("usb:3", {}, "usb:3"),
    )

    @pytest.fixture(autouse=True)
    def plugged(self, bridge):
        async def until_there():
            link = UsbLink()
            await open_when_there(link)
            await link.close()

        bridge.plug()
        asyncio.run(until_there())

    def make(self, tmp_path):
        return make_link("usb", speed=1.0, stand_in={})

    def open_wrongly(self, name, options):
        make_link(name, speed=1.0, stand_in={}, usb=options)


@pytest.mark.parametrize("name", ["copies", "no copies", "flight", "bench"])
def test_a_flight_arrives_whole_and_is_left_for_the_host_to_compare(name, tmp_path):
    """Bridges that forward copies, and ones that remove them; short flights, and long ones."""
    flight = unpacked(OUT / f"{name}.npz", tmp_path)
    sent = RecordedFlight(flight).packets

    async def fly():
        with EmulatedBridge(flight, awaited=True) as bridge:
            bridge.plug()
            link = UsbLink()
            await open_when_there(link)
            received = await packets_read(link, len(sent))
            await link.close()
            return received, link.counts.lost

    received, lost = asyncio.run(fly())
    assert lost == 0
    np.testing.assert_array_equal(received.packets, sent)
    np.savez(OUT / f"{name} through usb.npz", packets=received.packets, ns=received.host_time_ns)
