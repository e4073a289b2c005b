"""Radio and bridge: air time, loss, the bounded queue, USB frames."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_sim.bridge import Bridge
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.layout import RADIO_STREAM
from firmware_sim.radio import transmit
from firmware_sim.random_numbers import seeded
from firmware_sim.settings import Loss
from support.plant import rows_of


def heard(loss: Loss, packets: int = 20000, copies: int = 4):
    """(row, time, bit) of every copy that arrived."""
    times = np.arange(packets, dtype=np.int64) * 2_000_000
    numbers = np.array([loss.good_loss, loss.bad_loss, loss.to_bad, loss.to_good, loss.damage])
    row = np.empty(packets * copies, np.int64)
    when, bit = np.empty_like(row), np.empty_like(row)
    state = np.zeros(1, np.int64)
    count = transmit(times, copies, numbers, state, seeded(1, RADIO_STREAM + 1), row, when, bit)
    return row[:count], when[:count], bit[:count]


def test_four_copies_go_out_500_us_apart_after_their_air_time():
    row, when, _ = heard(Loss(good_loss=0.0), packets=3)
    assert row.tolist() == [0] * 4 + [1] * 4 + [2] * 4
    assert np.diff(when).tolist() == [500_000] * 11
    assert 295_000 < when[0] < 1_000_000


def test_independent_loss_takes_its_share_of_copies():
    row, _, _ = heard(Loss(good_loss=0.3))
    assert len(row) / 80000 == pytest.approx(0.7, abs=0.01)
    lost_samples = 20000 - len(np.unique(row))
    assert lost_samples / 20000 == pytest.approx(0.3**4, rel=0.25)


def test_gilbert_elliott_loss_comes_in_bursts():
    loss = Loss(good_loss=0.0, bad_loss=1.0, to_bad=0.01, to_good=0.1)
    row, when, _ = heard(loss)
    share = 0.01 / (0.01 + 0.1)
    assert 1 - len(row) / 80000 == pytest.approx(share, rel=0.1)
    bursts = np.diff(when) // 500_000 - 1
    assert bursts[bursts > 0].mean() == pytest.approx(1 / 0.1, rel=0.1)
    lost_samples = 1 - len(np.unique(row)) / 20000
    assert lost_samples > 5 * share**4  # far more than independent losses would take


def test_damage_flips_one_bit_of_the_stated_share():
    _, _, bit = heard(Loss(good_loss=0.0, damage=0.05))
    assert (bit >= 0).mean() == pytest.approx(0.05, abs=0.005)
    assert bit.max() == 255


def test_damaged_copies_disagree_with_the_others_in_one_bit():
    clean, _ = StandIn(StandInSettings(loss=Loss(good_loss=0.0))).advance(2.0)
    damaged, _ = StandIn(StandInSettings(loss=Loss(good_loss=0.0, damage=0.1))).advance(2.0)
    flipped = np.unpackbits(clean ^ damaged, axis=1).sum(axis=1)
    assert set(flipped) == {0, 1}
    assert (flipped == 1).mean() == pytest.approx(0.1, abs=0.02)


def packets_at(times_ns: list[int]):
    packets = np.zeros((len(times_ns), 32), np.uint8)
    packets[:, 0] = np.arange(len(times_ns))
    return packets, np.array(times_ns, np.int64)


def test_a_frame_carries_at_most_two_packets_and_arrives_when_it_ends():
    bridge = Bridge(64, False)
    out, arrival = bridge.pass_on(*packets_at([100, 200, 300, 400, 500]), 5_000_000)
    assert out[:, 0].tolist() == [0, 1, 2, 3, 4]
    assert (arrival // 1_000_000).tolist() == [2, 2, 3, 3, 4]


def test_a_packet_heard_after_a_frame_began_waits_for_the_next():
    bridge = Bridge(64, False)
    _, arrival = bridge.pass_on(*packets_at([1_000_000, 1_000_001]), 5_000_000)
    assert (arrival // 1_000_000).tolist() == [2, 3]


def test_a_full_queue_drops_the_newcomer_and_counts_it():
    bridge = Bridge(3, False)
    out, _ = bridge.pass_on(*packets_at([10, 20, 30, 40, 50]), 9_000_000)
    assert out[:, 0].tolist() == [0, 1, 2]
    assert bridge.overflows == 2


def test_the_bridge_gives_the_same_however_it_is_asked():
    generator = np.random.default_rng(4)
    times = np.sort(generator.integers(0, 200_000_000, 450))
    packets = generator.integers(0, 255, (450, 32)).astype(np.uint8)
    whole = Bridge(5, False)
    expected = whole.pass_on(packets, times, 300_000_000)
    sliced, parts, done = Bridge(5, False), [], 0
    for until in [*sorted(generator.integers(0, 300_000_000, 60)), 300_000_000]:
        upto = int(np.searchsorted(times, until, side="right"))
        parts.append(sliced.pass_on(packets[done:upto], times[done:upto], int(until)))
        done = upto
    assert (np.concatenate([p for p, _ in parts]) == expected[0]).all()
    assert (np.concatenate([t for _, t in parts]) == expected[1]).all()
    assert sliced.overflows == whole.overflows > 0


def test_a_bridge_that_removes_repeats_forwards_each_row_once():
    plain, dedup = (
        StandIn(StandInSettings(bridge_dedup=flag, loss=Loss(good_loss=0.2))).advance(5.0)[0]
        for flag in (False, True)
    )
    assert len(plain) > 3 * len(dedup)
    stamps = [rows_of(packets)["timestamp"] for packets in (plain, dedup)]
    shorter = min(map(len, stamps))
    assert (stamps[0][:shorter] == stamps[1][:shorter]).all()
    assert len(rows_of(dedup)["timestamp"]) == len(dedup)


def test_a_craft_whose_clock_is_fast_overflows_the_queue_in_the_end():
    settings = StandInSettings(
        loss=Loss(good_loss=0.0), device_clock_ppm=500.0, bridge_packets=8, program="wait"
    )
    craft = StandIn(settings)
    packets, _ = craft.advance(60.0)
    assert craft.overflows == pytest.approx(60 * 2000 * 500e-6, rel=0.25)
    assert len(packets) == pytest.approx(60 * 2000, rel=1e-3)
