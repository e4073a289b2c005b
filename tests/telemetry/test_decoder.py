"""The decoder against an adversarial radio and host."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from groundstation.telemetry.decoder import COMPILE_FROM, Decoder, decode_all
from groundstation.telemetry.packet import Packets, encode
from groundstation.telemetry.samples import RawBatch, SampleBatch, packet_counts
from support.packets import EPOCH_NS, PERIOD_NS, Flight, Reception, fly, receive

seeds = st.integers(0, 2**32 - 1)


def decode_in_batches(raw: RawBatch, size: int, **options: int) -> tuple[SampleBatch, Decoder]:
    """As a link delivers them. Long flights take the compiled kernel, which does the same."""
    decoder = Decoder(**options)
    parts = [
        decoder.decode(RawBatch(raw.packets[i : i + size], raw.host_time_ns[i : i + size])).samples
        for i in range(0, len(raw), size)
    ]
    parts.append(decoder.finish().samples)
    return SampleBatch.concatenate(parts), decoder


def packets_of(samples: SampleBatch) -> Packets:
    return encode(**packet_counts(samples))


def assert_every_arrived_sample_once(
    samples: SampleBatch, flight: Flight, reception: Reception
) -> None:
    """Each sample of which a sound copy arrived is there once, with its content and time."""
    arrived = np.unique(reception.sample[reception.sample >= 0])
    assert np.array_equal(packets_of(samples), flight.packets[arrived])
    for boot in np.unique(flight.boot[arrived]):
        mine = flight.boot[arrived] == boot
        offset = samples.ticks[mine] - flight.ticks[arrived][mine]
        assert (offset == offset[0]).all(), f"time off by {np.unique(offset - offset[0])} ticks"
    assert (np.diff(samples.ticks) > 0).all()


@settings(max_examples=30)
@given(
    seed=seeds,
    copies=st.sampled_from([1, 4]),
    loss=st.floats(0, 0.9),
    burst=st.floats(0, 0.5),
    swap=st.floats(0, 0.5),
    size=st.integers(1, 200),
)
def test_no_sample_that_arrived_is_lost_or_doubled_under_loss_and_interleaving(
    seed: int, copies: int, loss: float, burst: float, swap: float, size: int
) -> None:
    rng = np.random.default_rng(seed)
    flight = fly(rng, [(400, 0.0, False)])
    reception = receive(rng, flight, copies=copies, loss=loss, burst=burst, swap=swap)
    samples, decoder = decode_in_batches(reception.batch, size)
    assert_every_arrived_sample_once(samples, flight, reception)
    arrived = np.unique(reception.sample)
    counts = decoder.counts()
    assert counts.samples == len(arrived)
    assert counts.duplicates == len(reception.sample) - len(arrived)
    if len(arrived):
        assert counts.lost == arrived[-1] - arrived[0] + 1 - len(arrived)


def test_a_sample_that_its_successor_overtakes_is_given_out_in_its_place() -> None:
    rng = np.random.default_rng(3)
    flight = fly(rng, [(100, 0.0, False)])
    reception = receive(rng, flight, copies=1, loss=0.0, burst=0.0, swap=0.3)
    assert (np.diff(reception.sample) < 0).sum() > 5
    samples, decoder = decode_in_batches(reception.batch, 16)
    assert_every_arrived_sample_once(samples, flight, reception)
    assert decoder.counts().lost == 0


@settings(max_examples=40)
@given(
    seed=seeds,
    silences=st.lists(st.floats(0.1, 60.0), min_size=1, max_size=3),
    copies=st.sampled_from([1, 4]),
    loss=st.floats(0, 0.6),
)
def test_time_is_right_to_the_sample_after_silences_of_any_length(
    seed: int, silences: list[float], copies: int, loss: float
) -> None:
    rng = np.random.default_rng(seed)
    flight = fly(rng, [(200, 0.0, False), *((200, s, False) for s in silences)])
    reception = receive(rng, flight, copies=copies, loss=loss)
    samples, decoder = decode_in_batches(reception.batch, 16, compiled=True)
    assert_every_arrived_sample_once(samples, flight, reception)
    assert decoder.counts().restarts == 0
    assert (samples.segment == 0).all()


@settings(max_examples=40)
@given(
    seed=seeds,
    blocks=st.lists(st.tuples(st.floats(0.0, 8.0), st.floats(0.05, 5.0)), max_size=3),
    loss=st.floats(0, 0.7),
    copies=st.sampled_from([1, 4]),
    size=st.integers(4, 500),
)
def test_stamps_late_by_up_to_five_seconds_do_not_move_device_time(
    seed: int, blocks: list[tuple[float, float]], loss: float, copies: int, size: int
) -> None:
    rng = np.random.default_rng(seed)
    flight = fly(rng, [(5000, 0.0, False)])
    reception = receive(rng, flight, copies=copies, loss=loss, blocks=blocks)
    samples, decoder = decode_in_batches(reception.batch, size, compiled=True)
    assert_every_arrived_sample_once(samples, flight, reception)
    assert decoder.counts().restarts == 0


@settings(max_examples=40)
@given(
    seed=seeds,
    silence=st.floats(0.1, 20.0),
    block=st.tuples(st.floats(0.0, 1.0), st.floats(0.05, 5.0)),
    loss=st.floats(0, 0.5),
)
def test_a_silence_and_a_blocked_host_together_still_give_the_right_time(
    seed: int, silence: float, block: tuple[float, float], loss: float
) -> None:
    rng = np.random.default_rng(seed)
    flight = fly(rng, [(1000, 0.0, False), (5000, silence, False)])
    start = 2.0 + silence * block[0]  # anywhere from the last packet to the first after
    reception = receive(rng, flight, loss=loss, blocks=[(start, block[1])])
    samples, decoder = decode_in_batches(reception.batch, 16, compiled=True)
    assert_every_arrived_sample_once(samples, flight, reception)
    assert decoder.counts().restarts == 0


def assume_no_alias(reception: Reception) -> None:
    """299 samples are nine wraps of the stamp to 16 ticks: after such a gap, and with a host that
    was late on both sides of it, nothing tells how much time passed (docs/telemetry.md)."""
    gaps = np.diff(np.unique(reception.sample))
    assume(not (np.abs((gaps[gaps > 100] + 149) % 299 - 149) <= 16).any())


def late_around_a_silence(
    seed: int, silence: float, before: float, after: float, loss: float
) -> tuple[Flight, Reception]:
    """The host is late from ``before`` a silence until ``after`` its end, in s; a negative
    ``after`` is a share of the silence."""
    rng = np.random.default_rng(seed)
    flight = fly(rng, [(1000, 0.0, False), (2000, silence, False)])
    end = 2.0 + silence * (1 + min(0.0, after)) + max(0.0, after)
    return flight, receive(rng, flight, loss=loss, blocks=[(2.0 - before, end - 2.0 + before)])


@settings(max_examples=30)
@given(
    seed=seeds,
    silence=st.floats(1.8, 6.0),
    before=st.floats(0.0, 0.4),
    after=st.floats(-0.9, 0.5),
    loss=st.floats(0, 0.3),
)
def test_a_host_that_was_late_already_before_a_silence_gives_the_right_time(
    seed: int, silence: float, before: float, after: float, loss: float
) -> None:
    flight, reception = late_around_a_silence(seed, silence, before, after, loss)
    assume(abs((round(silence / 0.002) + 150) % 299 - 150) > 16)
    samples, decoder = decode_in_batches(reception.batch, 16, compiled=True)
    assert_every_arrived_sample_once(samples, flight, reception)
    assert decoder.counts().restarts == 0


def test_a_host_late_on_both_sides_of_a_short_silence_gives_the_right_time_nearly_always() -> None:
    """What no clock tells, by how often: 2 % of 3119 such silences (docs/telemetry.md)."""
    rng = np.random.default_rng(8)
    draws, wrong = 100, 0
    for seed in range(draws):
        silence, before = rng.uniform(0.1, 1.8), rng.uniform(0.0, 0.4)
        flight, reception = late_around_a_silence(
            seed, silence, before, rng.uniform(-0.9, 0.5), rng.uniform(0.0, 0.3)
        )
        samples, _ = decode_in_batches(reception.batch, 16, compiled=True)
        arrived = np.unique(reception.sample[reception.sample >= 0])
        got = packets_of(samples)
        # Misplaced or merged, but never invented and hardly ever lost.
        assert {one.tobytes() for one in got} <= {one.tobytes() for one in flight.packets}
        assert len(got) >= len(arrived) - 150
        wrong += not np.array_equal(got, flight.packets[arrived])
    assert wrong <= 12


@settings(max_examples=30)
@given(seed=seeds, stop=st.floats(0.2, 5.0), queue=st.integers(16, 1200), loss=st.floats(0, 0.2))
def test_a_stopped_process_whose_queue_overflows_loses_only_what_was_dropped(
    seed: int, stop: float, queue: int, loss: float
) -> None:
    rng = np.random.default_rng(seed)
    flight = fly(rng, [(4000, 0.0, False)])
    reception = receive(rng, flight, loss=loss, blocks=[(2.0, stop)], queue=queue)
    assume_no_alias(reception)
    samples, decoder = decode_in_batches(reception.batch, 16, compiled=True)
    assert_every_arrived_sample_once(samples, flight, reception)
    assert decoder.counts().restarts == 0


def test_a_restart_after_a_second_of_silence_is_found_at_the_stated_odds() -> None:
    found = 0
    runs = 300
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        silence = float(rng.uniform(1.05, 20.0))
        flight = fly(rng, [(150, 0.0, False), (150, silence, True)])
        reception = receive(rng, flight, loss=0.2)
        samples, decoder = decode_in_batches(reception.batch, 16, compiled=True)
        arrived = np.unique(reception.sample)
        assert np.array_equal(packets_of(samples), flight.packets[arrived])
        restarts = decoder.counts().restarts
        assert restarts <= 1
        found += restarts
        if restarts:
            assert np.array_equal(samples.segment, flight.boot[arrived])
            assert_every_arrived_sample_once(samples, flight, reception)
            gap_s = float(np.diff(samples.time_s).max())
            assert abs(gap_s - silence) < 0.1
    missed = 1 - found / runs
    assert missed < 0.055 + 3 * np.sqrt(0.055 * 0.945 / runs)


def test_a_reconnect_starts_a_new_segment_even_without_silence() -> None:
    rng = np.random.default_rng(1)
    flight = fly(rng, [(200, 0.0, False), (200, 0.0, True)])
    reception = receive(rng, flight)
    cut = int(np.flatnonzero(flight.boot[reception.sample] == 1)[0])
    raw, decoder = reception.batch, Decoder()
    parts = [decoder.decode(RawBatch(raw.packets[:cut], raw.host_time_ns[:cut])).samples]
    parts.append(decoder.reconnected().samples)
    parts.append(decoder.decode(RawBatch(raw.packets[cut:], raw.host_time_ns[cut:])).samples)
    parts.append(decoder.finish().samples)
    samples = SampleBatch.concatenate(parts)
    assert_every_arrived_sample_once(samples, flight, reception)
    assert np.array_equal(samples.segment, flight.boot)


@settings(max_examples=30)
@given(seed=seeds, damage=st.floats(0.0, 0.1), loss=st.floats(0, 0.1))
def test_copies_that_disagree_are_outvoted(seed: int, damage: float, loss: float) -> None:
    rng = np.random.default_rng(seed)
    flight = fly(rng, [(400, 0.0, False)])
    reception = receive(rng, flight, loss=loss, damage=damage)
    samples, decoder = decode_in_batches(reception.batch, 16)
    # three sound copies outvote the fourth whatever is wrong with it
    votes = np.bincount(reception.sample[reception.sample >= 0], minlength=len(flight.ticks))
    given_out = {bytes(packet) for packet in packets_of(samples)}
    assert all(bytes(flight.packets[row]) in given_out for row in np.flatnonzero(votes >= 3))
    assert (np.diff(samples.ticks) > 1972 / 2).all(), "a sample is there twice"
    sent = {bytes(packet) for packet in flight.packets}
    assert len(given_out - sent) <= np.count_nonzero(votes < 3)
    counts = decoder.counts()
    refused = counts.disagreeing + counts.damaged + counts.malformed + counts.late
    assert counts.samples + counts.duplicates + refused == counts.packets == len(reception.sample)


@pytest.mark.parametrize("damaged", range(4))
def test_one_damaged_copy_of_four_is_never_taken_for_the_sample(damaged: int) -> None:
    sent = encode(*([0] * 2), [[8] * 4], [[1, 2, 3]], [[4, 5, 6]], [[7, 8, 9]], 10)
    packets = np.repeat(sent, 4, axis=0)
    packets[damaged, 12] ^= 0x40  # the gyro's, where nothing tells damage
    stamps = EPOCH_NS + np.arange(4) * (PERIOD_NS // 4)
    samples, decoder = decode_in_batches(RawBatch(packets, stamps), 4)
    np.testing.assert_array_equal(packets_of(samples), sent)
    assert (int(samples.copies[0]), decoder.counts().disagreeing) == (3, 1)


@settings(max_examples=30)
@given(seed=seeds, shift=st.integers(1, 31), length=st.integers(1, 200))
def test_shifted_bytes_give_no_sample_and_are_counted(seed: int, shift: int, length: int) -> None:
    rng = np.random.default_rng(seed)
    flight = fly(rng, [(300, 0.0, False)])
    reception = receive(rng, flight)
    packets = reception.batch.packets.copy()
    start = int(rng.integers(100, len(packets) - length - 1))
    window = packets[start : start + length + 1].reshape(-1)
    shifted = window[shift : shift + length * 32].reshape(length, 32)
    packets[start : start + length] = shifted
    sample = reception.sample.copy()
    sample[start : start + length] = -1
    samples, decoder = decode_in_batches(RawBatch(packets, reception.batch.host_time_ns), 16)
    # identical neighbours: a shift inside a run of copies can restore a true packet by chance
    assert_every_arrived_sample_once(samples, flight, Reception(reception.batch, sample))
    counts = decoder.counts()
    refused = counts.malformed + counts.damaged + counts.disagreeing + counts.late
    assert refused == length


@settings(max_examples=20)
@given(seed=seeds, first=st.integers(0, 65535))
def test_the_stamp_may_wrap_at_any_place(seed: int, first: int) -> None:
    rng = np.random.default_rng(seed)
    flight = fly(rng, [(120, 0.0, False)])
    shifted = flight.ticks - flight.ticks[0] + first
    packets = flight.packets.copy()
    packets[:, 0], packets[:, 1] = shifted & 0xFF, (shifted >> 8) & 0xFF
    moved = Flight(shifted, flight.sent_ns, flight.boot, packets)
    reception = receive(rng, moved, loss=0.2)
    samples, _ = decode_in_batches(reception.batch, 7)
    assert_every_arrived_sample_once(samples, moved, reception)


@settings(max_examples=15)
@given(seed=seeds, loss=st.floats(0, 0.8), damage=st.floats(0, 0.05), silence=st.floats(0.1, 5))
def test_compiled_and_interpreted_kernels_give_identical_samples(
    seed: int, loss: float, damage: float, silence: float
) -> None:
    rng = np.random.default_rng(seed)
    flight = fly(rng, [(3000, 0.0, False), (3000, silence, True)])
    reception = receive(rng, flight, loss=loss, damage=damage, blocks=[(2.0, 1.0)])
    raw = reception.batch
    if len(raw) < COMPILE_FROM:
        return
    bulk, counts = decode_all(raw)
    live, decoder = decode_in_batches(raw, 64)
    assert counts == decoder.counts()
    assert np.array_equal(bulk.ticks, live.ticks)
    assert np.array_equal(packets_of(bulk), packets_of(live))


def test_a_known_start_keeps_absolute_device_time() -> None:
    rng = np.random.default_rng(3)
    flight = fly(rng, [(100, 0.0, False)])
    reception = receive(rng, flight)
    samples, _ = decode_in_batches(reception.batch, 16, start_ticks=int(flight.ticks[0]))
    assert np.array_equal(samples.ticks, flight.ticks)


@pytest.mark.parametrize("rows", [1, 2])
def test_a_stream_of_one_or_two_samples_gives_them(rows: int) -> None:
    rng = np.random.default_rng(4)
    flight = fly(rng, [(rows, 0.0, False)])
    samples, _ = decode_in_batches(receive(rng, flight).batch, 4)
    assert np.array_equal(packets_of(samples), flight.packets)


def test_a_quiet_link_gives_out_its_last_samples_without_waiting_for_more() -> None:
    rng = np.random.default_rng(5)
    flight = fly(rng, [(50, 0.0, False)])
    raw = receive(rng, flight).batch
    decoder = Decoder()
    early = decoder.decode(raw).samples
    assert len(early) < 50
    rest = decoder.idle(EPOCH_NS + 60 * PERIOD_NS + 100_000_000).samples
    assert len(early) + len(rest) == 50


def test_a_device_that_repeats_one_packet_for_ever_gives_one_sample() -> None:
    rng = np.random.default_rng(6)
    flight = fly(rng, [(100, 0.0, False)])
    raw = receive(rng, flight).batch
    stuck = np.repeat(raw.packets[-1:], 20_000, axis=0)
    host = raw.host_time_ns[-1] + np.arange(1, 20_001) * 500_000
    both = RawBatch(np.concatenate([raw.packets, stuck]), np.concatenate([raw.host_time_ns, host]))
    samples, _ = decode_in_batches(both, 16)
    assert len(samples) == 100
