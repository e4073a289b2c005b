"""The bus as a clock: stamps that are never early, and frames that nobody saw."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from groundstation.links.usb import SETTLE_BLOCKS, FrameClock
from groundstation.telemetry.packet import FRAME_NS

FRAMES = 8
QUEUED = 120
START_NS = 1_700_000_000_000_000_000
LATE_NS = 300_000


def see(clock, frame, late_ns, ppm=0.0):
    """The block that ends with bus frame ``frame`` is seen ``late_ns`` after its end."""
    ended_ns = START_NS + round(frame * FRAME_NS * (1 + ppm * 1e-6))
    stamp_ns = clock.see(FRAMES, ended_ns + late_ns, QUEUED)
    return stamp_ns - ended_ns


def stream(clock, first, blocks, late_ns=LATE_NS, ppm=0.0):
    return [see(clock, first + FRAMES * (at + 1), late_ns, ppm) for at in range(blocks)]


def test_a_blocked_program_gets_the_stamps_of_a_running_one():
    clock = FrameClock()
    stream(clock, 0, 100)
    late = [100e6 - 8e6 * at for at in range(12)]
    errors = [see(clock, 800 + 8 * (at + 1), round(ns)) for at, ns in enumerate(late)]
    assert max(errors) < LATE_NS + 100_000
    assert min(errors) >= 0
    assert clock.lost == 0


@given(
    lates=st.lists(st.integers(20_000, 110_000_000), min_size=20, max_size=300),
    ppm=st.floats(-150, 150),
)
def test_a_stamp_is_never_early_and_never_after_it_was_seen(lates, ppm):
    clock = FrameClock()
    for at, late_ns in enumerate(lates):
        error_ns = see(clock, FRAMES * (at + 1), late_ns, ppm)
        assert 0 <= error_ns <= late_ns
    assert clock.lost == 0


def seen_of(lates, ppm):
    ends = [round(FRAMES * (at + 1) * FRAME_NS * (1 + ppm * 1e-6)) for at in range(len(lates))]
    return [START_NS + end_ns + late_ns for end_ns, late_ns in zip(ends, lates, strict=True)]


def test_a_program_that_is_busy_when_the_stream_begins_gets_the_stamps_of_an_idle_one():
    clock = FrameClock()
    lates = [round(50e6 - 8e6 * at) for at in range(6)] + [LATE_NS] * 10
    clock.anchor(FRAMES, seen_of(lates, 0.0))
    errors = [see(clock, FRAMES * (at + 1), late_ns) for at, late_ns in enumerate(lates)]
    assert min(errors) >= 0
    assert max(errors) < LATE_NS + 100_000


@given(
    lates=st.lists(st.integers(20_000, 110_000_000), min_size=16, max_size=100),
    ppm=st.floats(-150, 150),
)
def test_a_stamp_that_was_waited_for_is_never_early_either(lates, ppm):
    clock = FrameClock()
    clock.anchor(FRAMES, seen_of(lates[:16], ppm))
    for at, late_ns in enumerate(lates):
        assert 0 <= see(clock, FRAMES * (at + 1), late_ns, ppm) <= late_ns


@given(gaps=st.lists(st.integers(0, 2000), min_size=1, max_size=4), ppm=st.floats(-100, 100))
def test_frames_that_passed_a_dry_queue_are_counted_to_the_last_one(gaps, ppm):
    """Away for longer than the queue lasts: what it holds comes late, then frames are missing."""
    clock = FrameClock()
    frame = 0
    for gap in gaps:
        stream(clock, frame, 40, ppm=ppm)
        frame += 40 * FRAMES
        back_ns = START_NS + round((frame + QUEUED + FRAMES + gap) * FRAME_NS * (1 + ppm * 1e-6))
        for _ in range(QUEUED // FRAMES + 1):
            frame += FRAMES
            ended_ns = START_NS + round(frame * FRAME_NS * (1 + ppm * 1e-6))
            stamp_ns = clock.see(FRAMES, max(back_ns, ended_ns) + LATE_NS, QUEUED)
            assert stamp_ns >= ended_ns
        frame += gap
    stream(clock, frame, SETTLE_BLOCKS + 20, ppm=ppm)
    assert clock.lost == sum(gaps)


@given(gap=st.integers(0, 500))
def test_an_announced_interruption_is_counted_too(gap):
    clock = FrameClock()
    stream(clock, 0, 50)
    clock.interrupt()
    errors = stream(clock, 400 + gap, 5)
    assert min(errors) >= 0
    clock.settle()
    assert clock.lost == gap


def test_frames_dropped_unread_are_no_gap():
    clock = FrameClock()
    stream(clock, 0, 50)
    clock.skip(10 * FRAMES)
    errors = stream(clock, 60 * FRAMES, 100)
    assert clock.lost == 0
    assert np.ptp(errors) < 100_000
