from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from groundstation.links.command import LinkEvent
from groundstation.telemetry.samples import COLUMNS, SampleBatch, empty_samples
from groundstation.viewer.messages import (
    MAX_BYTES,
    MAX_ROWS,
    Acknowledgement,
    decode_acknowledgement,
    decode_message,
    encode_message,
    message_of,
    samples_in,
)


@st.composite
def batches(draw):
    rows = draw(st.integers(0, 5))
    shapes = empty_samples(rows)
    columns = {
        name: draw(arrays.arrays(getattr(shapes, name).dtype, getattr(shapes, name).shape))
        for name in COLUMNS
    }
    return SampleBatch(**columns, tick_s=draw(st.floats(1e-9, 1.0)))


@given(batch=batches())
def test_samples_arrive_bit_by_bit(batch):
    kind, content = decode_message(encode_message(message_of(batch)))
    arrived = samples_in(content)
    assert kind == "samples"
    assert arrived.tick_s == batch.tick_s
    for name in COLUMNS:
        assert getattr(arrived, name).dtype == getattr(batch, name).dtype
        assert getattr(arrived, name).tobytes() == getattr(batch, name).tobytes()
        assert getattr(arrived, name).shape == getattr(batch, name).shape


def test_a_full_message_fits_the_readers_buffer():
    message = message_of(empty_samples(MAX_ROWS))
    assert len(encode_message(message)) < MAX_BYTES / 2


def test_an_event_may_carry_details_that_only_python_knows():
    details = {"path": ValueError("no such port"), "n": 3}
    event = LinkEvent(5, "usb", "fault", "gone", details)
    _, content = decode_message(encode_message(message_of(event)))
    assert content["time_ns"] == 5
    assert content["details"] == {"path": "no such port", "n": 3}


@given(total=st.integers(0, 2**62))
def test_acknowledgements_carry_their_count(total):
    assert decode_acknowledgement(encode_message(Acknowledgement(total))).taken == total


@given(data=st.binary(max_size=64))
def test_noise_is_refused(data):
    with pytest.raises(ValueError, match="not a message"):
        decode_message(data + b"\xc1")


def test_decoded_samples_are_views_not_copies():
    batch = samples_in(decode_message(encode_message(message_of(empty_samples(4))))[1])
    assert not batch.gyro.flags.owndata
    assert batch.ticks.dtype == np.int64
