"""What a name carries in predictions, where something is left to explain."""

import numpy as np
import pytest

from groundstation.discrepancy.proof import weight

GIVEN_GAP = 3.0
SECONDS = 50


def rows(*squares):
    """Squared errors over noise by second of three channels whose mean squares these are; the
    other six are not there."""
    scatter = 1.0 + 0.1 * np.random.default_rng(1).standard_normal((SECONDS, 3))
    scatter /= scatter.mean(axis=0)
    found = np.full((SECONDS, 9), np.nan)
    found[:, :3] = scatter * np.array(squares) / (3.0 * SECONDS)
    return found


def test_a_name_that_a_channel_needs_carries_that_share_of_it():
    found = weight(GIVEN_GAP, rows(1.0, 1.0, 1.0), rows(5.0, 1.0, 1.0), (0, 1))
    assert found.most == pytest.approx(1.0)
    assert found.share == pytest.approx((4.0 / 3.0) / (GIVEN_GAP**2 - 1.0))
    assert found.is_carried
    assert not found.raises


def test_one_that_takes_less_than_a_fiftieth_of_what_its_channels_are_left_with_is_not_carried():
    assert not weight(GIVEN_GAP, rows(5.0, 1.0, 1.0), rows(5.05, 1.0, 1.0), (0, 1)).is_carried
    assert weight(GIVEN_GAP, rows(5.0, 1.0, 1.0), rows(5.2, 1.0, 1.0), (0, 1)).is_carried


def test_one_without_which_all_channels_together_are_predicted_better_raises_the_gap():
    found = weight(GIVEN_GAP, rows(2.0, 4.0, 1.0), rows(3.0, 1.0, 1.0), (0, 1))
    assert found.most > 0.4
    assert not found.is_carried
    assert found.raises


def test_where_its_channels_are_within_noise_it_is_not_asked():
    """Another channel is far beyond noise, which is none of its business."""
    assert weight(GIVEN_GAP, rows(1.0, 9.0, 1.0), rows(1.1, 9.0, 1.0), (0, 2)) is None
    assert weight(GIVEN_GAP, rows(1.0, 9.0, 1.0), rows(1.1, 9.0, 1.0), (0, 1)) is not None


def test_a_doubt_within_what_seconds_scatter_raises_nothing():
    noisy = rows(2.0, 2.0, 2.0)
    noisy[:, 0] *= np.where(np.arange(SECONDS) % 2, 1.9, 0.11)
    found = weight(GIVEN_GAP, noisy, rows(2.0, 2.0, 2.0), (0,))
    assert found.share < 0.0
    assert not found.raises
