"""Packets of log blocks become rows: stamps, loss, restarts, units."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from firmware_sim.contents import compressed
from groundstation.links.log_rows import LogPlan, LogRows, decompressed
from groundstation.telemetry.samples import SampleBatch

MS_NS = 1_000_000
FIRST = tuple((f"gyro.{axis}", "float") for axis in "xyz")
SECOND = tuple((f"acc.{axis}", "float") for axis in "xyz")
PLAN = LogPlan((FIRST, SECOND), {name: name for name, _ in FIRST + SECOND}, ())


def packets(times_ms, block, values=lambda t: (0.0, 0.0, 0.0), delay_ms=3):
    return [(block, t % (1 << 24), values(t), (t + delay_ms) * MS_NS) for t in times_ms]


def in_order(*streams):
    return sorted(itertools.chain(*streams), key=lambda packet: packet[3])


def test_blocks_of_the_same_moment_make_one_row_in_the_units_of_a_sample():
    rows = LogRows(PLAN, 10)
    samples = rows.add(
        in_order(
            packets(range(0, 1000, 10), 0, lambda t: (t / 10, 0, 180.0)),
            packets(range(0, 1000, 10), 1, lambda t: (0.0, 0.0, 1.0)),
        )
    )
    assert len(samples) == 100
    assert samples.time_s == pytest.approx(np.arange(100) * 0.01)
    assert samples.gyro[:, 0] == pytest.approx(np.radians(np.arange(100)), rel=1e-6)
    assert samples.accelerometer[:, 2] == pytest.approx(9.80665, rel=1e-6)
    assert samples.host_time_ns.tolist() == [(t + 3) * MS_NS for t in range(0, 1000, 10)]
    assert np.isnan(samples.attitude).all()
    assert rows.apart_ms == 0


MOTORS = tuple((f"motor.m{m}", "uint16_t") for m in range(1, 5))


def test_the_motors_of_a_row_are_those_that_acted_before_it():
    """The firmware sets them from the gyro that it has just read."""
    plan = LogPlan((FIRST, MOTORS), {name: name for name, _ in FIRST + MOTORS}, ())
    rows = LogRows(plan, 4)
    times = [t for t in range(0, 400, 4) if t != 200]

    def motors(t):
        return (t, t, t, t)

    stream = in_order(packets(times, 0), packets(times, 1, motors))
    parts = [rows.add(stream[first : first + 30]) for first in range(0, len(stream), 30)]
    samples = SampleBatch.concatenate([part for part in parts if len(part)])
    set_at = np.rint(samples.duty[:, 0] * 65535).astype(int)
    read_at = np.rint(samples.time_s * 1000).astype(int)
    late = np.isin(read_at, [0, 204])
    assert (set_at[late] == read_at[late]).all()
    assert (set_at[~late] == read_at[~late] - 4).all()


def test_stamps_go_on_where_their_24_bits_are_used_up():
    start = (1 << 24) - 500
    rows = LogRows(PLAN, 4)
    times = range(start, start + 1000, 4)
    samples = rows.add(in_order(packets(times, 0), packets(times, 1)))
    assert (np.diff(samples.ticks) == 4000).all()
    assert rows.counts().lost == 0


def test_what_is_lost_is_counted_exactly_whichever_block_it_was_in():
    draws = np.random.default_rng(0)
    times = np.arange(0, 60_000, 10)
    heard = [times[draws.random(len(times)) > 0.04] for _ in range(2)]
    for each in heard:
        each[[0, -1]] = times[[0, -1]]
    whole = set(heard[0].tolist()) & set(heard[1].tolist())
    rows = LogRows(PLAN, 10)
    samples = rows.add(
        in_order(*(packets(sorted(set(each.tolist())), n) for n, each in enumerate(heard)))
    )
    assert len(samples) == len(whole)
    assert rows.counts().lost == len(times) - len(whole)
    assert rows.counts().samples == len(samples)


def test_blocks_of_other_moments_are_read_between_their_neighbours():
    rows = LogRows(PLAN, 10)
    samples = rows.add(
        in_order(
            packets(range(100, 400, 10), 0),
            packets(range(94, 400, 10), 1, lambda t: (t * 1e-3, 0.0, 0.0)),
        )
    )
    assert samples.accelerometer[:, 0] == pytest.approx(9.80665 * samples.time_s, rel=1e-5)
    assert rows.apart_ms == 4


def test_a_clock_that_begins_anew_begins_a_segment():
    rows = LogRows(PLAN, 10)
    first = rows.add(in_order(*(packets(range(50_000, 51_000, 10), n) for n in range(2))))
    again = [packets(range(200, 900, 10), n, delay_ms=60_000) for n in range(2)]
    second = rows.add(in_order(*again))
    assert set(first.segment) == {0}
    assert set(second.segment) == {1}
    assert second.ticks[0] == 200_000
    assert rows.counts().restarts == 1
    assert rows.counts().lost == 0


def test_a_row_waits_no_longer_than_its_blocks_may_still_come():
    rows = LogRows(PLAN, 10)
    assert len(rows.add(packets([0], 0))) == 0
    assert len(rows.add(packets([0], 1))) == 1
    assert len(rows.add(packets([10, 20, 30, 40], 0))) == 0
    assert len(rows.add(packets([30], 1))) == 1  # 10 and 20 were not completed


def test_attitude_in_32_bits_is_that_of_the_firmware():
    quaternions = Rotation.random(200, random_state=1).as_quat()
    codes = np.array([compressed(tuple(q)) for q in quaternions], np.uint32)
    back = decompressed(codes)
    same = np.abs((back * quaternions).sum(axis=1))
    assert np.degrees(2 * np.arccos(np.minimum(same, 1.0))).max() < 0.25


TWICE = LogPlan(
    (FIRST + MOTORS, SECOND + MOTORS), {name: name for name, _ in FIRST + SECOND + MOTORS},
    (), again=1,
)  # fmt: skip
"""The motors in both blocks."""


def test_a_slow_row_holds_the_mean_of_both_settings_that_acted_before_it():
    """Motors are set every 2 ms: the second block tells of those between the rows."""
    rows = LogRows(TWICE, 4)
    times = [t for t in range(0, 400, 4) if t != 200]

    def in_first(t):
        return (0.0, 0.0, 0.0, *4 * (100.0 * t,))

    def in_second(t):
        return (0.0, 0.0, float(t), *4 * (100.0 * t,))

    between = [t + 2 for t in range(0, 400, 4)]
    samples = rows.add(in_order(packets(times, 0, in_first), packets(between, 1, in_second)))
    read_at = np.rint(samples.time_s * 1000).astype(int)
    assert read_at.tolist() == times[1:]
    acted = samples.duty[:, 2] * 65535 / 100.0
    whole = ~np.isin(read_at, [4, 204])  # the setting before these rows was not heard
    assert acted[whole] == pytest.approx(read_at[whole] - 3)  # of those 4 and 2 ms ago
    assert samples.duty_step[whole] == pytest.approx(200.0 / 65535, rel=1e-4)
    assert np.isnan(samples.duty_step[~whole]).all()
    assert samples.accelerometer[:, 2] == pytest.approx(9.80665 * read_at, rel=1e-6)


def test_a_row_of_more_than_two_settings_does_not_tell_one_from_the_other():
    rows = LogRows(TWICE, 10)

    def block(t):
        return (0.0, 0.0, 0.0, *4 * (100.0 * t,))

    first, second = packets(range(0, 400, 10), 0, block), packets(range(5, 400, 10), 1, block)
    samples = rows.add(in_order(first, second))
    assert np.isfinite(samples.duty).all()
    assert np.isnan(samples.duty_step).all()


def test_a_second_block_of_the_same_moment_tells_nothing_more_of_the_motors():
    rows = LogRows(TWICE, 4)
    times = range(0, 400, 4)

    def both(t):
        return (0.0, 0.0, 0.0, *4 * (100.0 * t,))

    samples = rows.add(in_order(packets(times, 0, both), packets(times, 1, both)))
    acted = samples.duty[1:, 0] * 65535 / 100.0
    assert acted == pytest.approx(np.rint(samples.time_s[1:] * 1000) - 4)
    assert np.isnan(samples.duty_step).all()


@pytest.mark.parametrize("block", [0, 1])
def test_while_one_block_stays_away_what_comes_of_the_other_is_not_hoarded(block):
    rows = LogRows(PLAN, 4)
    rows.add(in_order(packets(range(0, 40, 4), 0), packets(range(0, 40, 4), 1)))
    for first in range(40, 40_000, 400):
        assert len(rows.add(packets(range(first, first + 400, 4), block))) <= 1
        assert max(map(len, rows._waiting)) < 30
    late = in_order(packets(range(40_040, 41_000, 4), 0), packets(range(40_040, 41_000, 4), 1))
    assert len(rows.add(late)) == 240
