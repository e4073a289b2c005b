"""Whose clock stamped the samples, and what is missing by its count."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.telemetry.samples import empty_samples, on_even_grid, row_steps

PERIOD_S = 0.01


def stamped(time_s, tick_s=1e-6):
    samples = empty_samples(len(time_s), tick_s)
    samples.ticks[:] = np.rint(np.asarray(time_s) / tick_s)
    return samples


def late(seed, rows, scale_s):
    """Times of rows that came late by chance, in the order in which they came."""
    delays = np.random.default_rng(seed).exponential(scale_s, len(rows))
    return np.sort(np.asarray(rows) * PERIOD_S + delays)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.002, 0.008), st.floats(0.003, 0.02))
def test_late_stamps_are_no_loss(seed, scale_s, period_s):
    scale_s = min(scale_s, 0.5 * period_s)
    rng = np.random.default_rng(seed)
    arrivals = np.sort(np.arange(1500) * period_s + rng.exponential(scale_s, 1500))
    steps = row_steps(stamped(arrivals))
    assert steps.lost.sum() == 0
    assert steps.period_s == pytest.approx(period_s, rel=0.05)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sets(st.integers(2, 38), min_size=1, max_size=6))
def test_what_is_missing_among_late_stamps_is_counted(seed, gaps):
    kept = np.delete(np.arange(2000), [50 * g + k for g in gaps for k in range(5)])
    steps = row_steps(stamped(late(seed, kept, 0.003)))
    assert steps.by_host
    assert steps.lost.sum() == pytest.approx(5 * len(gaps), abs=1)


def test_the_grid_behind_late_stamps_is_even_and_keeps_what_is_missing():
    kept = np.delete(np.arange(2000), np.arange(700, 720))
    even = on_even_grid(stamped(late(3, kept, 0.003)))
    place = even.time_s / PERIOD_S
    assert np.diff(place) == pytest.approx(np.diff(kept), abs=0.01)
    assert place - kept == pytest.approx(0.0, abs=0.2)


def test_bursts_are_late_and_not_lost():
    rows = np.arange(2000)
    arrivals = (rows // 5 + 1) * 5 * PERIOD_S + 1e-4 * (rows % 5)
    steps = row_steps(stamped(arrivals))
    assert steps.by_host
    assert steps.lost.sum() == 0
    assert steps.period_s == pytest.approx(PERIOD_S, rel=0.01)


@given(st.sets(st.integers(1, 398), max_size=100))
def test_a_craft_s_steps_are_counted_as_they_are(missing):
    kept = np.array([row for row in range(400) if row not in missing])
    samples = stamped(kept * PERIOD_S + 1e-6 * (kept % 3))
    steps = row_steps(samples)
    assert not steps.by_host
    assert steps.lost.sum() == len(missing)
    assert on_even_grid(samples) is samples


@pytest.mark.parametrize("hz", [300, 400, 700])
def test_a_clock_of_whole_ms_is_no_host(hz):
    steps = row_steps(stamped(np.floor(np.arange(3000) / hz * 1e3) * 1e-3))
    assert not steps.by_host
    assert steps.lost.sum() == 0
    assert steps.period_s == pytest.approx(1 / hz, rel=0.01)
