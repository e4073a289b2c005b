from __future__ import annotations

import socket

import numpy as np
import pytest

from groundstation.telemetry.packet import TICK_S
from groundstation.telemetry.samples import COLUMNS, SampleBatch, empty_samples
from groundstation.viewer.messages import MAX_BYTES, MAX_ROWS, decode_message, samples_in
from groundstation.viewer.viewer import Outbox


@pytest.fixture
def channel():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    theirs.setblocking(False)
    with ours, theirs:
        yield ours, theirs


def received(theirs):
    """What has come: batches, and the content of notes."""
    messages = []
    while True:
        try:
            kind, content = decode_message(theirs.recv(MAX_BYTES))
        except BlockingIOError:
            return messages
        messages.append(samples_in(content) if kind == "samples" else content)


def numbered(rows, first=0):
    """Samples that carry their number."""
    samples = empty_samples(rows)
    samples.debug[:] = np.arange(first, first + rows)
    return samples


def numbers(messages):
    return [number for batch in messages for number in batch.debug.tolist()]


def test_small_batches_leave_as_one_message(channel, wobble):
    ours, theirs = channel
    outbox = Outbox()
    for first in range(0, 40, 5):
        outbox.put_samples(wobble(5, first))
    outbox.flush(ours)
    (batch,) = received(theirs)
    expected = SampleBatch.concatenate([wobble(5, first) for first in range(0, 40, 5)])
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(batch, name), getattr(expected, name))
    assert (outbox.sent, outbox.dropped, outbox.waiting) == (40, 0, 0)


def test_a_huge_batch_leaves_in_pieces_and_only_its_newest_part(channel):
    ours, theirs = channel
    outbox = Outbox(max_rows=2000)
    outbox.put_samples(numbered(7300))
    outbox.flush(ours)
    messages = received(theirs)
    assert max(map(len, messages)) <= MAX_ROWS
    assert numbers(messages) == list(range(6000, 7300))
    assert (outbox.sent, outbox.dropped) == (1300, 6000)


def test_sources_with_different_clocks_do_not_share_a_message(channel):
    ours, theirs = channel
    outbox = Outbox()
    outbox.put_samples(empty_samples(3))
    outbox.put_samples(empty_samples(4, tick_s=1e-6))
    outbox.flush(ours)
    assert [(len(one), one.tick_s) for one in received(theirs)] == [(3, TICK_S), (4, 1e-6)]


def test_a_reader_that_stops_reading_costs_the_oldest_samples_and_no_memory(channel):
    ours, theirs = channel
    outbox = Outbox(max_rows=500)
    for first in range(0, 100_000, 50):
        outbox.put_samples(numbered(50, first))
        outbox.flush(ours)
        assert outbox.waiting <= 500
    assert outbox.dropped > 50_000
    assert outbox.sent + outbox.dropped + outbox.waiting == 100_000
    arrived = numbers(received(theirs))
    assert arrived == list(range(outbox.sent))
    outbox.flush(ours)
    assert numbers(received(theirs)) == list(range(100_000 - 500, 100_000))


def test_notes_are_bounded_too_and_keep_their_order(channel):
    ours, theirs = channel
    outbox = Outbox(max_notes=3)
    for number in range(5):
        outbox.put_note(("event", {"time_ns": number}))
    outbox.flush(ours)
    assert [note["time_ns"] for note in received(theirs)] == [2, 3, 4]
    assert (outbox.sent, outbox.dropped) == (3, 2)


def test_a_note_too_large_for_a_message_is_dropped_and_does_not_block_the_next(channel):
    ours, theirs = channel
    outbox = Outbox()
    outbox.put_note(("event", {"time_ns": 1, "text": "x" * MAX_BYTES}))
    outbox.put_note(("event", {"time_ns": 2}))
    outbox.flush(ours)
    assert [note["time_ns"] for note in received(theirs)] == [2]
    assert (outbox.sent, outbox.dropped) == (1, 1)


def test_what_a_reader_did_not_take_before_it_died_counts_as_dropped(channel, wobble):
    ours, _ = channel
    outbox = Outbox()
    outbox.put_samples(wobble(30))
    outbox.flush(ours)
    outbox.taken(10)
    outbox.put_samples(wobble(5))
    outbox.flush(ours)
    outbox.new_reader()
    assert (outbox.sent, outbox.dropped) == (10, 25)


def test_a_closed_reader_is_an_error_and_keeps_what_waits(channel, wobble):
    ours, theirs = channel
    theirs.close()
    outbox = Outbox()
    outbox.put_samples(wobble(30))
    with pytest.raises(ConnectionError):
        outbox.flush(ours)
    assert (outbox.sent, outbox.waiting) == (0, 30)
