"""Runs: a gap, a restart or another rate is never read as motion."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.errors import BadInputError
from groundstation.identification.flight import turning_parts
from groundstation.identification.runs import runs_of
from groundstation.telemetry.samples import empty_samples


def samples_at(ticks, segment=0):
    samples = empty_samples(len(ticks), tick_s=1e-6)
    return replace(
        samples,
        ticks=np.asarray(ticks, np.int64),
        segment=np.broadcast_to(np.int32(segment), len(ticks)).copy(),
        duty=np.full((len(ticks), 4), 0.5, np.float32),
    )


def even(rows, period_us=2000, start=0):
    return start + period_us * np.arange(rows)


def test_an_uninterrupted_recording_is_one_run():
    (run,) = runs_of(samples_at(even(1000, start=5_000_000)))
    assert len(run) == 1000
    assert run.start_s == 5.0
    assert run.period_s == pytest.approx(0.002)
    np.testing.assert_allclose(run.time_s, 5 + 0.002 * np.arange(1000))


def test_lost_rows_and_restarts_end_a_run():
    ticks = np.concatenate([even(800), even(900, start=2_000_000), even(700, start=4_000_000)])
    segment = np.concatenate([np.zeros(1100), np.ones(1300)]).astype(np.int32)
    runs = runs_of(replace(samples_at(ticks), segment=segment))
    assert [len(run) for run in runs] == [800, 600, 700]  # 300 rows before the restart: too short
    assert runs[1].start_s == pytest.approx(2.6)


def test_one_lost_row_ends_a_run():
    ticks = np.delete(even(2001), 1000)
    assert [len(run) for run in runs_of(samples_at(ticks))] == [1000, 1000]


@given(st.lists(st.integers(1, 400), min_size=1, max_size=6))
def test_no_row_is_in_two_runs_and_no_run_spans_a_gap(lengths):
    start, pieces = 0, []
    for length in lengths:
        pieces.append(even(length, start=start))
        start += 2000 * length + 50_000
    samples = samples_at(np.concatenate(pieces))
    if len(samples) < 3:
        return
    expected = [length for length in lengths if length * 0.002 >= 0.2]
    if not expected:
        with pytest.raises(BadInputError):
            runs_of(samples, least_s=0.2)
        return
    if sum(lengths) - len(lengths) > 2 * len(lengths):  # the usual step is the small one
        assert [len(run) for run in runs_of(samples, least_s=0.2)] == expected


def test_jitter_of_the_clock_is_not_a_gap():
    generator = np.random.default_rng(0)
    ticks = even(1000) + generator.integers(-300, 300, 1000)
    assert len(runs_of(samples_at(ticks))) == 1


@pytest.mark.parametrize(("period_us", "text"), [(100_000, "samples a second"), (100, "second")])
def test_a_rate_that_is_no_telemetry_is_refused(period_us, text):
    with pytest.raises(BadInputError, match=text):
        runs_of(samples_at(even(3000, period_us)))


def test_a_recording_of_crumbs_is_refused_with_its_longest_stretch():
    ticks = np.concatenate([even(100, start=k * 1_000_000) for k in range(5)])
    with pytest.raises(BadInputError, match=r"0\.20 s"):
        runs_of(samples_at(ticks))


def test_flying_stretches_leave_the_ground_out():
    samples = samples_at(even(5000))
    duty = samples.duty.copy()
    duty[:1000] = 0
    duty[3000:3010, 2] = 0.05
    duty[4000:] = 0
    (run,) = runs_of(replace(samples, duty=duty))
    assert [len(part) for part in turning_parts(run, 2.0)] == [2000]
    assert [len(part) for part in turning_parts(run, 1.0)] == [2000, 990]


def test_a_part_keeps_its_time():
    (run,) = runs_of(samples_at(even(1000)))
    part = run[200:300]
    assert (len(part), part.start_s) == (100, pytest.approx(0.4))
    with pytest.raises(ValueError, match="consecutive"):
        run[::2]
