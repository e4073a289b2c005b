"""The USB link under the contract of every link, and one flight through it."""

import asyncio

import numpy as np
import pytest
from emulated_bridge import EmulatedBridge, RecordedFlight, open_when_there, rows_of
from link_contract import LinkContract, joined, read_span

from groundstation.links.factory import make_link
from groundstation.links.usb import UsbLink
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import COLUMNS, RawBatch


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


@pytest.mark.parametrize("kind", ["flight", "filtered_flight"])
def test_a_flight_through_usb_gives_the_samples_of_the_flight_itself(kind, request):
    """A bridge that forwards copies, and one that removes them."""
    path = request.getfixturevalue(kind)

    async def fly():
        with EmulatedBridge(path) as bridge:
            bridge.plug()
            link = UsbLink()
            await open_when_there(link)
            received = joined(await read_span(link, 1_000_000_000))
            await link.close()
            return received, link.counts.lost

    received, lost = asyncio.run(fly())
    assert lost == 0
    sent = RecordedFlight(path).packets
    rows = rows_of(sent, received.packets)
    direct = RawBatch(sent[rows], received.host_time_ns)
    np.testing.assert_array_equal(received.packets, direct.packets)
    ours, _ = decode_all(received)
    theirs, counts = decode_all(direct)
    assert counts.lost == 0
    assert len(ours) > 450
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
