"""What a finding is proven by: predictions of held-out rows."""

import math
from dataclasses import replace

import numpy as np
from compared_flights import judged

from groundstation.discrepancy.proof import worse_channels


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
