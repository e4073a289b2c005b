"""The running median behind what is left of a spectrum."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from groundstation.discrepancy.screening import median_of

NUMBERS = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30)


@given(NUMBERS)
def test_a_median_is_numpys(numbers):
    values = np.array(numbers)
    assert median_of(values) == np.median(values)
