"""What can go wrong on the bus: the stream goes on, and each lost frame is counted once."""

import asyncio
import contextlib
import time

import pytest
from emulated_bridge import EmulatedBridge, RecordedFlight, open_when_there

from groundstation.errors import LinkLostError
from groundstation.links.usb import FRAMES, UsbLink
from support.links import joined
from support.usb_device import Fault, FaultKind

SPAN_S = 1.0


async def read_for(link, span_s):
    batches = []
    end_s = time.monotonic() + span_s
    while time.monotonic() < end_s:
        batch = await link.read()
        if batch is not None:
            batches.append(batch)
    return batches


def stream_with(flight, faults, disturb=None):
    """Read until the faults are past and the counts have settled, then pull the cable.

    Unplugging ends the stream for both sides at the same frame, so that the counts compare.
    """

    async def session():
        with EmulatedBridge(flight, faults) as bridge:
            link = UsbLink()
            bridge.plug()
            await open_when_there(link)
            batches = await read_for(link, SPAN_S / 2)
            if disturb is not None:
                disturb()
            batches += await read_for(link, SPAN_S)
            bridge.unplug()
            with contextlib.suppress(LinkLostError):
                while True:
                    if (batch := await link.read()) is not None:
                        batches.append(batch)
            await link.close()
            return joined(batches), link.counts, bridge.counts()

    return asyncio.run(session())


def require_right_bytes(flight, received):
    """Everything delivered was sent, in that order: the flight with parts left out."""
    sent = iter(map(bytes, RecordedFlight(flight).packets))
    for packet in map(bytes, received.packets):
        assert packet in sent, "a packet that was never sent, or out of order"


def require_equal_counts(ours, theirs, what):
    """Told as a row of the table in docs/usb.md."""
    print(f"| {what} | {theirs.lost} | {ours.lost} |")
    assert ours.lost == theirs.lost
    assert ours.frames == theirs.good
    assert ours.packets == theirs.packets
    assert ours.unseen == theirs.dry + theirs.halted


BY_STATUS = {
    FaultKind.SHORT: "ragged",
    FaultKind.CRC: "errors",
    FaultKind.PROTOCOL: "errors",
    FaultKind.MISSED: "errors",
    FaultKind.OVERRUN: "overruns",
    FaultKind.PIPE: "stalls",
}


def test_an_endpoint_that_halts_again_and_again_is_given_up(flight):
    faults = [Fault(at, FaultKind.STALL) for at in range(0, 2000, 8)]

    async def session():
        with EmulatedBridge(flight, faults) as bridge:
            link = UsbLink()
            bridge.plug()
            await open_when_there(link)
            with pytest.raises(LinkLostError, match="gives no frames"):
                await read_for(link, SPAN_S)
            await link.close()

    asyncio.run(session())


def test_faults_of_every_kind_cost_their_frames_alone_and_each_is_counted(flight):
    """Faulty frames, an endpoint that halts, and a program away for longer than its transfers last,
    of which nothing reports."""
    kinds = list(BY_STATUS)
    faults = [Fault(100 + 7 * at, kinds[at % len(kinds)], 5) for at in range(100)]
    faults.insert(50, Fault(451, FaultKind.STALL))
    received, ours, theirs = stream_with(flight, faults, disturb=lambda: time.sleep(0.3))
    assert theirs.dry > 100
    assert theirs.halted > 0
    assert theirs.good > 700
    assert len(theirs.faulty) == len(kinds)
    for count in set(BY_STATUS.values()):
        faulty = [theirs.faulty[kind] for kind, name in BY_STATUS.items() if name == count]
        assert getattr(ours, count) == sum(faulty), count
    require_equal_counts(ours, theirs, "faults of every kind")
    require_right_bytes(flight, received)


def test_a_cable_that_is_pulled_in_a_frame_and_put_back_costs_no_count(flight):
    """Each stream begins anew on our side; the emulator counts through all of them."""
    faults = [Fault(301, FaultKind.UNPLUG), Fault(100, FaultKind.CRC), Fault(402, FaultKind.UNPLUG)]

    async def session():
        streams = []
        with EmulatedBridge(flight, faults) as bridge:
            link = UsbLink()
            for _ in range(2):
                bridge.plug()
                await open_when_there(link)
                batches = []
                with contextlib.suppress(LinkLostError):
                    while True:
                        if (batch := await link.read()) is not None:
                            batches.append(batch)
                await link.close()
                streams.append((joined(batches), link.counts))
            return streams, bridge.counts()

    (first, second), theirs = asyncio.run(session())
    assert (first[1].errors, second[1].errors) == (0, 1)
    assert first[1].lost == 0
    print(f"| unplugged and plugged in, one bad frame | {theirs.lost} | {second[1].lost} |")
    assert second[1].lost == theirs.lost == 1
    assert first[1].frames == 301 // FRAMES * FRAMES
    assert first[1].frames + second[1].frames == theirs.good
    assert first[1].packets + second[1].packets == theirs.packets
    require_right_bytes(flight, joined([first[0], second[0]]))
