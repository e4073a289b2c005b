"""Every stage of the program has one notion of which attitudes are new."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.prediction.drive import changed_rows, fresh_rhythm, fresh_rows, rhythm_of

ROWS = 400


def angles(stride, phase=0, seed=1):
    """Angles that are new every ``stride`` rows."""
    new = np.cumsum(np.random.default_rng(seed).normal(size=(ROWS, 3)), axis=0)
    rows = np.arange(ROWS)
    return new[np.maximum(rows - (rows - phase) % stride, 0)]


@pytest.mark.parametrize(("stride", "phase"), [(1, 0), (2, 0), (2, 1), (5, 3)])
def test_held_angles_tell_how_often_and_when_the_attitude_is_new(stride, phase):
    shown = angles(stride, phase)
    rhythm = fresh_rhythm(shown)
    assert (rhythm.stride, rhythm.phase, rhythm.regular) == (stride, phase, True)
    held = fresh_rows(shown)[phase:].reshape(-1)
    np.testing.assert_array_equal(np.flatnonzero(held) % stride, 0)
    assert (np.diff(shown, axis=0)[~fresh_rows(shown)[1:]] == 0).all()


def test_held_angles_that_are_left_out_tell_the_same():
    shown = angles(2, 1)
    left_out = np.where(fresh_rows(shown)[:, None], shown, np.nan)
    assert fresh_rhythm(left_out) == fresh_rhythm(shown)


def test_the_rhythm_survives_lost_rows():
    shown = angles(2)
    shown[np.random.default_rng(2).random(ROWS) < 0.05] = np.nan
    assert fresh_rhythm(shown) == fresh_rhythm(angles(2))
    assert not changed_rows(shown)[np.isnan(shown).any(axis=1)].any()


def test_a_craft_that_rests_half_of_the_time_has_the_rhythm_of_the_other_half():
    shown = angles(2)
    shown[: ROWS // 2] = shown[0]
    assert fresh_rhythm(shown) == fresh_rhythm(angles(2))


def test_without_a_rhythm_every_row_counts():
    irregular = np.cumsum(np.random.default_rng(3).random((ROWS, 1)) < 0.4, axis=0) * np.ones(3)
    assert fresh_rows(irregular).all()
    assert fresh_rows(np.full((ROWS, 3), np.nan)).all()
    assert not rhythm_of(changed_rows(irregular)).regular
