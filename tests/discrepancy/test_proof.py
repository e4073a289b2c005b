"""What a finding is proven by: predictions of held-out rows."""

import math
from dataclasses import replace

import numpy as np
import pytest
from compared_flights import judged

from groundstation.discrepancy.proof import WORSE_T, HeldOut, worse_channels


def test_a_model_that_predicts_no_number_is_worse_than_any_other():
    given = judged()
    errors = []
    for one in given.errors:
        horizons = [rows.copy() for rows in one.horizons]
        for rows in horizons:
            rows[:, 0] = np.nan
        errors.append(replace(one, horizons=tuple(horizons)))
    assert worse_channels(given, replace(given, errors=tuple(errors))) == {0: math.inf}
    assert worse_channels(given, given) == {}


@pytest.mark.parametrize(("floor", "worse"), [(1.0, {0: WORSE_T}), (1e3, {})])
def test_a_model_that_is_wrong_in_one_second_alone_is_worse_where_noise_is_less(floor, worse):
    given = judged()
    noise = (tuple(floor * rows for rows in one.horizons) for one in given.floors)
    floors = [replace(one, horizons=rows) for one, rows in zip(given.floors, noise, strict=True)]
    given = replace(given, floors=tuple(floors))
    errors = []
    for one in given.errors:
        horizons = [rows.copy() for rows in one.horizons]
        middle, second = len(horizons[0]) // 2, round(1.0 / one.run.period_s)
        for rows in horizons:
            rows[:, 0] *= 0.99
            rows[middle : middle + second, 0] *= 20.0
            rows[middle : middle + second, 1] *= 1.01
        errors.append(replace(one, horizons=tuple(horizons)))
    found = worse_channels(given, replace(given, errors=tuple(errors)))
    assert found == worse


def test_two_seconds_are_enough_to_see_that_a_model_is_far_worse():
    given = judged()
    parts = {1.0: [], 20.0: []}
    for one in given.errors:
        middle, second = len(one.horizons[0]) // 2, round(1.0 / one.run.period_s)
        for factor, found in parts.items():
            horizons = [np.full_like(rows, np.nan) for rows in one.horizons]
            for rows, all_rows in zip(horizons, one.horizons, strict=True):
                rows[middle : middle + second] = all_rows[middle : middle + second]
                rows[:, 0] *= factor
            found.append(replace(one, horizons=tuple(horizons)))
    before, after = (replace(given, errors=tuple(errors)) for errors in parts.values())
    assert worse_channels(before, after) == {0: WORSE_T}


def test_what_the_seconds_add_is_the_squared_gap():
    given = judged()
    found = HeldOut(given).judge(given.model)
    assert sum(found.blocks) == pytest.approx(found.gap**2)
