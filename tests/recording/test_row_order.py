"""Rows as files have them: overtaken, doubled, behind a wrapped counter, after a restart."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.recording.column_map import WRAPS_S, order_of
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import write_mcap
from groundstation.recording.quality import inspect_recording

MS = 1e-3
COUNTERS = [(bits, unit_s) for bits in (24, 32) for unit_s in (1e-3, 1e-6)]


def put(ticks, tick_s=MS, values=None):
    ticks = np.asarray(ticks, np.int64)
    return order_of(ticks, tick_s, [np.arange(len(ticks)) if values is None else values])


@given(st.sets(st.integers(0, 98), max_size=30), st.integers(1, 20))
def test_whatever_neighbours_are_exchanged_stand_in_order_again(places, step):
    ticks = np.arange(100) * step
    written = ticks.copy()
    swapped = [k for k in sorted(places) if k - 1 not in places]
    for k in swapped:
        written[[k, k + 1]] = written[[k + 1, k]]
    found = put(written)
    assert found.ticks.tolist() == ticks.tolist()
    assert not found.segment.any()
    assert found.overtaken == len(swapped)
    assert written[found.rows if found.rows is not None else slice(None)].tolist() == ticks.tolist()


@given(st.integers(2, 20), st.integers(0, 80))
def test_a_block_that_comes_late_stands_where_it_is_missing(length, first):
    ticks = 2 * np.arange(200)
    late = np.arange(first, first + length)
    written = np.concatenate([np.delete(ticks[:150], late), ticks[late], ticks[150:]])
    found = put(written)
    assert found.ticks.tolist() == ticks.tolist()


@given(st.integers(2, 60), st.integers(2, 60))
def test_a_clock_that_begins_anew_is_a_restart(before, after):
    found = put([*2 * np.arange(before), *(2 * np.arange(after))])
    assert found.segment.tolist() == [0] * before + [1] * after
    assert found.overtaken == 0


@pytest.mark.parametrize(("bits", "unit_s"), COUNTERS)
@pytest.mark.parametrize("tick_s", [1e-9, 1e-6])
def test_a_counter_that_comes_round_goes_on(bits, unit_s, tick_s):
    step = round(0.002 / unit_s)
    counted = (2**bits - 50 * step + step * np.arange(100)) % 2**bits
    found = put(counted * round(unit_s / tick_s), tick_s)
    assert set(np.diff(found.ticks)) == {round(0.002 / tick_s)}
    assert (found.wraps, found.overtaken, found.segment.max()) == (1, 0, 0)


def test_rows_exchanged_where_the_counter_comes_round_still_go_on():
    counted = (2**24 - 100 + 2 * np.arange(100)) % 2**24
    counted[[49, 50]] = counted[[50, 49]]
    found = put(counted)
    assert set(np.diff(found.ticks)) == {2}
    assert found.overtaken == 1


@given(st.lists(st.integers(1, 3), min_size=1, max_size=50))
def test_rows_that_are_equal_in_every_cell_are_one_row(times):
    values = np.repeat(np.arange(len(times)) * 1.5, times)
    found = put(np.repeat(2 * np.arange(len(times)), times), values=values)
    assert found.of(values).tolist() == [1.5 * k for k in range(len(times))]
    assert found.copies.tolist() == times
    assert found.left_out == sum(times) - len(times)


def test_rows_of_one_time_that_differ_are_kept():
    found = put([0, 2, 2, 4], values=np.array([1.0, 2.0, 3.0, 3.0]))
    assert found.ticks.tolist() == [0, 2, 2, 4]
    empty = put([0, 2, 2, 4], values=np.array([1.0, np.nan, np.nan, 3.0]))
    assert empty.ticks.tolist() == [0, 2, 4]


def test_a_file_says_what_became_of_its_rows_and_a_recording_made_of_it_too(tmp_path):
    lines = [f"{2 * k},{k % 7},{-k % 5},{k % 3}" for k in range(100)]
    lines[10], lines[11] = lines[11], lines[10]
    lines[50:50] = lines[49:50]
    text = "\n".join(["Timestamp,gyro.x,gyro.y,gyro.z", *lines]) + "\n"
    (tmp_path / "log.csv").write_text(text)
    recording = open_recording(tmp_path / "log.csv")
    write_mcap(recording, tmp_path / "log.mcap")
    for one in (recording, open_recording(tmp_path / "log.mcap")):
        report = inspect_recording(one)
        assert (report["samples"], report["duplicates"], report["out_of_order"]) == (100, 1, 1)
        assert (report["segments"], report["lost_samples"], report["repeated_times"]) == (1, 0, 0)


@pytest.mark.parametrize("turn_s", WRAPS_S)
def test_a_pause_of_nearly_a_counter_s_turn_is_a_pause(turn_s):
    ticks = np.array([0, round(turn_s * 1e6) - 900_000])
    order = put(ticks, 1e-6)
    assert order.ticks.tolist() == ticks.tolist()
    assert order.notes == {}
