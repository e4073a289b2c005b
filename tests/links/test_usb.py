"""What the USB link does where there is no bridge; with one, see ``tests/usb_vm``."""

import asyncio
import ctypes
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.errors import BadInputError, LinkError
from groundstation.links.base import LinkState
from groundstation.links.factory import make_link
from groundstation.links.usb import FRAMES, Block, UsbLink, parse_ids, require_private_names
from groundstation.telemetry.packet import FRAME_NS
from groundstation.telemetry.packet import USB_FRAME_BYTES as FRAME_BYTES
from support.waiting import eventually

ABSENT = "1209:0001"
SEEN_NS = 1_700_000_000_000_000_000


@pytest.mark.parametrize(
    "device", ["", "0483", "0483:574", "04 83:5741", "0483:5741:1", "g483:5741"]
)
def test_a_wrong_device_is_refused_with_an_example(device):
    with pytest.raises(BadInputError, match="give VID:PID, for example 0483:5741"):
        make_link("usb", speed=1.0, stand_in={}, usb={"device": device})


def test_ids_are_hexadecimal_in_either_case():
    assert parse_ids("1D6b:00aF") == (0x1D6B, 0x00AF)


async def test_an_absent_device_is_told_at_once_and_then_waited_for():
    link = UsbLink(device=ABSENT)
    with pytest.raises(LinkError, match="no USB device 1209:0001 is plugged in"):
        await link.open()
    assert link.state is LinkState.CLOSED
    waiting = asyncio.create_task(link.open())
    await eventually(lambda: link.state is LinkState.OPENING)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    await link.close()
    assert link.state is LinkState.CLOSED


def test_a_pyusb_with_other_inner_names_is_refused_before_anything_is_read():
    stranger = SimpleNamespace(backend=SimpleNamespace(lib=ctypes.CDLL(None)))
    with pytest.raises(LinkError, match=r"backend\.ctx, _ctx\.handle\.handle.*pip install"):
        require_private_names(stranger)


frames = st.tuples(
    st.sampled_from([0, 0, 0, 0, 1, 4, 6, -71]), st.integers(0, FRAME_BYTES), st.booleans()
)


@given(rows=st.lists(st.lists(frames, min_size=FRAMES, max_size=FRAMES), max_size=5))
def test_only_whole_packets_of_good_frames_are_delivered_and_every_frame_is_counted(rows):
    link = UsbLink()
    expected, bad, ragged = [], 0, 0
    for number, row in enumerate(rows):
        # what a bad frame leaves in the buffer looks like a packet, and is none
        data = np.full((FRAMES, FRAME_BYTES), 0xEE, np.uint8)
        described = np.zeros((FRAMES, 3), "<i4")
        for at, (status, length, whole) in enumerate(row):
            length = length // 32 * 32 if whole else length
            described[at] = FRAME_BYTES, length, status
            if status:
                bad += 1
            elif length % 32:
                ragged += 1
            else:
                data[at] = number * FRAMES + at
                expected += [number * FRAMES + at] * (length // 32)
        seen_ns = SEEN_NS + (number + 1) * FRAMES * FRAME_NS
        link._take(Block(data.tobytes(), described.tobytes(), seen_ns, 120))
    batch = link._decode()
    assert batch.packets[:, 0].tolist() == expected
    assert (batch.packets == batch.packets[:, :1]).all()
    counts = link.counts
    assert counts.errors + counts.stalls + counts.overruns == bad
    assert counts.ragged == ragged
    assert counts.frames == len(rows) * FRAMES - bad - ragged
    ends = (batch.host_time_ns - SEEN_NS) // FRAME_NS
    assert (np.abs(ends - 1 - np.array(expected, int)) <= 1).all()


def test_a_link_that_nobody_reads_keeps_the_latest_frames_and_counts_the_rest():
    link = UsbLink()
    blocks = 1024 + 100
    for number in range(blocks):
        data = np.full(FRAMES * FRAME_BYTES, number % 251, np.uint8).tobytes()
        link._take(Block(data, None, SEEN_NS + number * FRAMES * FRAME_NS, 120))
    batch = link._decode()
    assert link.counts.unread == 100 * FRAMES
    assert len(batch) == 1024 * FRAMES * 2
    assert batch.packets[-1, 0] == (blocks - 1) % 251
    assert batch.host_time_ns[-1] == SEEN_NS + (blocks - 1) * FRAMES * FRAME_NS
