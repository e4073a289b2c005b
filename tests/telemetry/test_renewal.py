"""How often a channel is renewed, whatever rows repeat it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.telemetry.samples import renewals, rows_held, slower_than_rows

RNG = np.random.default_rng(0)


def noise(rows):
    return RNG.normal(size=(rows, 3)).astype(np.float32)


@given(st.integers(1, 50), st.integers(40, 200))
def test_a_value_that_stands_for_so_many_rows_is_measured(hold, values):
    held = np.repeat(noise(values), hold, axis=0)
    assert rows_held(renewals(held)) == pytest.approx(hold)
    assert slower_than_rows(renewals(held)) == pytest.approx(hold if hold > 1 else 1.0)


@given(st.floats(2.1, 12.0))
def test_a_source_of_any_rate_is_measured(hold):
    held = noise(1000)[(np.arange(2000) / hold).astype(int)]
    assert slower_than_rows(renewals(held)) == pytest.approx(hold, rel=0.02)


@given(st.integers(2, 20))
def test_a_column_that_is_empty_between_its_values_is_as_slow(hold):
    sparse = np.full((1000, 3), np.nan, np.float32)
    sparse[::hold] = noise(len(sparse[::hold]))
    assert rows_held(renewals(sparse)) == pytest.approx(hold)


def test_a_rest_makes_no_channel_slow():
    resting = np.concatenate([np.zeros((3000, 3), np.float32), noise(1000)])
    assert slower_than_rows(renewals(resting)) == 1.0


def test_what_changes_by_chance_is_no_slow_source():
    now_and_then = np.cumsum(RNG.random(20_000) < 0.05)
    assert slower_than_rows(renewals(now_and_then)) == 1.0
    assert np.isnan(rows_held(renewals(np.zeros(100))))
