"""What the craft's firmware sends is what the codec reads, through radio and bridge."""

import ctypes
import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.telemetry.decoder import Decoder
from groundstation.telemetry.packet import SAMPLE_TICKS, as_packets, decode, encode, motor_counts
from groundstation.telemetry.samples import RawBatch
from support.firmware import BladeTimer, Bridge, Craft, Sample, firmware, packed

I16 = st.integers(-32768, 32767)
VECTOR = st.tuples(I16, I16, I16)
ANGLE = st.floats(-400, 400, width=32)
ANY_FLOAT = st.floats(width=32)
GOLDEN = bytes.fromhex(
    "06 24 aa 0c 30 8d c3 98 8b c7 43 fe b5 02 b5 ffb7 fe 4a 0c 1b 1e f3 fe d1 fd c0 f3 80 4f 50 49"
)
"""Row 8517 of the thesis's excerpt, debug 1230000000."""


def sample_of(ticks, *, counter=0, ratios=(0, 0, 0, 0)):
    return Sample(
        ticks=int(ticks) % 65536, battery_v=3.7, motor_ratio=ratios,
        accelerometer=(0, 0, 4096), debug=counter,
    )  # fmt: skip


def test_the_golden_packet_is_what_the_craft_packs():
    ratios = [count << 4 for count in (3376, 3128, 2968, 3192)]
    sample = Sample(
        9222, 3.242, tuple(ratios), (-445, 693, -75), (-329, 3146, 7707),
        -2.69, -5.59, -31.36, 1230000000,
    )  # fmt: skip
    assert packed(sample) == GOLDEN


@given(
    ticks=st.integers(0, 65535), millivolts=st.integers(0, 65535),
    ratios=st.lists(st.integers(0, 65535), min_size=4, max_size=4),
    gyro=VECTOR, accelerometer=VECTOR, angles=st.tuples(ANGLE, ANGLE, ANGLE),
    debug=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_any_sample_is_the_packet_of_the_codec(
    ticks, millivolts, ratios, gyro, accelerometer, angles, debug
):
    sample = Sample(ticks, millivolts / 1000, tuple(ratios), gyro, accelerometer, *angles, debug)
    hundredths = np.clip(100 * np.array(angles), -32768, 32767)
    read = decode(as_packets(packed(sample)))[0]
    # single precision lies to either side of a half; otherwise every bit is the codec's
    assert np.all(np.abs(read["angles"] - hundredths) <= 0.5 + 4e-3)
    motors = np.array(ratios) // 128 * 8
    whole = encode(ticks, millivolts, motors, gyro, accelerometer, read["angles"], debug)
    assert packed(sample) == whole.tobytes()


@given(values=st.tuples(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT, ANY_FLOAT))
def test_what_no_field_can_hold_stays_at_its_limit(values):
    battery, *angles = values
    sample = Sample(battery_v=battery, roll_deg=angles[0], pitch_deg=angles[1], yaw_deg=angles[2])
    read = decode(as_packets(packed(sample)))[0]
    for value, field, low, high in [
        (1000 * battery, read["battery"], 0, 65535),
        *((100 * a, c, -32768, 32767) for a, c in zip(angles, read["angles"], strict=True)),
    ]:
        expected = low if math.isnan(value) else min(max(value, low), high)
        assert abs(int(field) - expected) <= 0.5 + 4e-3


def test_a_packet_goes_out_four_times_and_a_loop_that_hangs_is_silent():
    craft = Craft()
    sent = []
    craft.chip.hear = lambda air, payload: sent.append(payload)
    assert not craft.tick(), "nothing was published"
    first, second = sample_of(1), sample_of(2)
    for sample, ticks in ((first, 4), (second, 40)):
        craft.publish(sample)
        for _ in range(ticks):
            craft.tick()
    assert sent == [packed(first)] * 4 + [packed(second)] * 4


def test_a_radio_that_lost_its_supply_sends_again_within_a_second():
    craft, bridge = Craft(), Bridge()
    craft.chip.hear = bridge.chip.take
    craft.chip.power_down()
    heard = []
    for ms2 in range(500):
        craft.publish(sample_of(1973 * ms2, counter=ms2))
        for _ in range(4):
            craft.tick()
            bridge.receive()
        heard.append(bool(bridge.frame()))
        bridge.frame()
    assert not any(heard[:50])
    assert all(heard[-20:])


def test_a_bridge_knows_a_radio_that_is_missing_or_was_reset_and_sets_it_up_again():
    bridge = Bridge()
    assert bridge.is_set()
    bridge.chip.power_down()
    assert not bridge.is_set()
    bridge.start()
    assert bridge.is_set()
    bridge.chip.miso = False
    assert not bridge.is_set()


def test_the_interrupt_pin_is_released_with_the_last_packet():
    craft, bridge = Craft(), Bridge()
    craft.chip.hear = bridge.chip.take
    craft.publish(sample_of(0))
    for _ in range(3):
        craft.tick()
    assert bridge.chip.interrupt
    bridge.receive()
    assert not bridge.chip.interrupt
    assert len(bridge.frame() + bridge.frame()) == 3 * 32


@settings(max_examples=12)
@given(loss=st.floats(0, 0.7), seed=st.integers(0, 99), forward_copies=st.booleans())
def test_every_sample_that_came_through_the_air_is_decoded_once(loss, seed, forward_copies):
    """Craft, radio, bridge and USB frames in C; the ground station's decoder behind them."""
    rng = np.random.default_rng(seed)
    craft, bridge = Craft(), Bridge(forward_copies)
    arrived = set()

    def over_the_air(air, payload):
        if rng.random() >= loss:
            arrived.add(payload)
            bridge.chip.take(air, payload)

    craft.chip.hear = over_the_air
    frames, sent = [], []
    rows = 300
    for ms in range(2 * rows + 20):
        if ms % 2 == 0 and ms < 2 * rows:
            ratios = tuple(int(r) for r in rng.integers(0, 65536, 4))
            sample = sample_of(round(ms / 2 * SAMPLE_TICKS), counter=ms // 2, ratios=ratios)
            sent.append(packed(sample))
            craft.publish(sample)
        for _ in range(2):
            craft.tick()
            bridge.receive()
        frames.append(bridge.frame())
    assert {len(frame) for frame in frames} <= {0, 32, 64}
    packets = as_packets(b"".join(frames))
    times = np.repeat(np.arange(len(frames)), [len(f) // 32 for f in frames]) * 1_000_000
    decoder = Decoder()
    parts = [
        decoder.decode(RawBatch(packets, 10**18 + times.astype(np.int64))).samples,
        decoder.finish().samples,
    ]
    counters = np.concatenate([part.debug for part in parts])
    assert len(counters) >= 0.7 * rows
    assert counters.tolist() == [row for row, packet in enumerate(sent) if packet in arrived]
    truth = motor_counts(decode(as_packets(b"".join(sent))))[counters.astype(int)]
    duty = np.concatenate([part.duty for part in parts])
    np.testing.assert_allclose(duty * 4096, truth, atol=1e-3)
    counts = decoder.counts()
    assert counts.malformed == counts.damaged == counts.disagreeing == 0
    if not forward_copies:
        assert counts.duplicates == 0


@given(half_turns=st.lists(st.integers(247, 60000), min_size=1, max_size=30),
       begin=st.integers(0, 2**32 - 1), bounce=st.integers(1, 246))  # fmt: skip
def test_the_blade_timer_gives_half_a_turn_whatever_the_counter_and_a_bouncing_edge(
    half_turns, begin, bounce
):
    timer, now = BladeTimer(), begin
    edge = firmware().blade_timer_edge
    edge(ctypes.byref(timer), now)
    assert timer.half_turn == 0
    for half_turn in half_turns:
        now = (now + half_turn) % 2**32
        edge(ctypes.byref(timer), now)
        assert timer.half_turn == half_turn
        edge(ctypes.byref(timer), (now + bounce) % 2**32)
        assert timer.half_turn == half_turn


def test_a_craft_whose_clock_is_faster_than_the_bus_costs_copies_and_never_a_sample():
    bridge = Bridge()
    got = b""
    for row in range(1200):  # 4 copies each, but three frames for two rows: too slow by a quarter
        for _ in range(4):
            bridge.put(packed(sample_of(row * 1973, counter=row)))
        got += bridge.frame() + (bridge.frame() if row % 2 else b"")
    read = decode(as_packets(got + b"".join(bridge.frame() for _ in range(20))))
    assert np.unique(read["debug"]).tolist() == list(range(1200))
    assert bridge.queue.dropped == 0
    assert bridge.queue.copies_left_out > 0


def test_a_full_queue_drops_new_packets_and_counts_them():
    bridge = Bridge()
    sent = [packed(sample_of(row)) for row in range(40)]
    for packet in sent:
        bridge.put(packet)
    assert bridge.queue.dropped == 8
    got = b"".join(iter(bridge.frame, b""))
    assert got == b"".join(sent[:32])
    bridge.put(sent[-1])
    firmware().queue_clear(ctypes.byref(bridge.queue))
    assert bridge.frame() == b""
