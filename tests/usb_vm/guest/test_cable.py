"""Cables that are pulled and put back, and devices that are not what they should be."""

import asyncio
import os
import time
from pathlib import Path

import pytest
from emulated_bridge import EmulatedBridge, open_when_there, read_until_lost

from groundstation.errors import LinkError
from groundstation.links.base import LinkState
from groundstation.links.usb import DEFAULT_DEVICE, BridgeDevice, UsbLink
from support.links import joined, listen, read_span

REPLUG_STREAMS_S = 2.0


def test_a_device_that_is_plugged_in_again_streams_within_two_seconds(bridge):
    async def session():
        link = UsbLink()
        bridge.plug()
        await open_when_there(link)
        await link.read()
        bridge.unplug()
        await read_until_lost(link)
        await link.close()
        opening = asyncio.create_task(link.open())
        await asyncio.sleep(3.3)
        bridge.plug()
        plugged_s = time.monotonic()
        await opening
        assert (await link.read()) is not None
        again_s = time.monotonic() - plugged_s
        await link.close()
        return again_s

    assert asyncio.run(session()) < REPLUG_STREAMS_S


def test_closing_an_unplugged_device_is_harmless(bridge):
    async def session():
        link = UsbLink()
        bridge.plug()
        await open_when_there(link)
        bridge.unplug()
        await link.close()
        await link.close()
        assert link.state is LinkState.CLOSED

    asyncio.run(session())


def test_a_device_that_is_absent_is_named_and_waited_for(bridge):
    async def session():
        link = UsbLink(serial="VM1")
        events = listen(link)
        with pytest.raises(LinkError, match="0483:5741 with serial number VM1 is plugged in"):
            await link.open()
        opening = asyncio.create_task(link.open())
        await asyncio.sleep(1.2)
        assert link.state is LinkState.OPENING
        bridge.plug()
        await opening
        batches = await read_span(link)
        await link.close()
        return events, batches

    events, batches = asyncio.run(session())
    assert len(joined(batches)) > 100
    assert [event.kind for event in events] == [
        "opening", "closed", "opening", "streaming", "closed",
    ]  # fmt: skip


def test_of_several_bridges_the_one_with_the_serial_number_is_read(flight):
    async def session():
        with EmulatedBridge(flight, serial="LEFT") as left, EmulatedBridge(flight) as right:
            left.plug()
            right.plug()
            link = UsbLink(serial="VM1")
            await open_when_there(link)
            await read_span(link)
            await link.close()
            return left.counts().good, right.counts().good

    ignored, read = asyncio.run(session())
    assert ignored == 0
    assert read > 100


def test_a_bridge_that_is_in_use_says_so(bridge):
    async def session():
        first, second = UsbLink(), UsbLink()
        bridge.plug()
        await open_when_there(first)
        with pytest.raises(LinkError, match="in use by another program"):
            await second.open()
        assert (await first.read()) is not None
        await first.close()
        await second.open()
        await second.close()

    asyncio.run(session())


def test_without_permission_the_rule_and_the_command_that_installs_it_are_told(bridge):
    bridge.plug()

    async def until_there():
        link = UsbLink()
        await open_when_there(link)
        await link.close()

    asyncio.run(until_there())
    device, nobody = BridgeDevice(DEFAULT_DEVICE, ""), 65534
    device.find()  # what another user could not read here is loaded before
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        os.setuid(nobody)
        try:
            device.claim()
        except LinkError as error:
            os.write(theirs, str(error).encode())
        os._exit(0)
    os.waitpid(child, 0)
    os.close(theirs)
    told = os.read(ours, 4096).decode()
    os.close(ours)
    assert "no permission" in told
    assert "groundstation install udev --print" in told
    assert "\n" not in told


def test_a_device_without_the_endpoint_is_refused_in_one_line():
    """A root hub of the kernel itself has the wrong endpoints."""
    hubs = list(Path("/sys/bus/usb/devices").glob("usb*"))
    assert hubs

    async def session():
        with pytest.raises(LinkError, match="is no telemetry bridge") as refused:
            await UsbLink(device="1d6b:0002").open()
        assert "\n" not in str(refused.value)

    asyncio.run(session())
