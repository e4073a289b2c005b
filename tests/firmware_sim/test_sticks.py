"""The rows of a pilot's programme, asked for a little ahead of what is flown."""

import numpy as np

from firmware_sim import programme
from firmware_sim.programme import Sticks, load_programme


def test_rows_are_the_same_however_they_are_asked_for_and_no_segment_is_made_twice(monkeypatch):
    flown = load_programme("excite")
    whole = Sticks(flown, 3).rows(0, 40_000)
    made = []
    rows_of = programme._segment_rows
    monkeypatch.setattr(
        programme, "_segment_rows", lambda *given: made.append(given) or rows_of(*given)
    )
    sticks = Sticks(flown, 3)
    for first in range(0, 39_990, 7):
        np.testing.assert_array_equal(sticks.rows(first, 9), whole[first : first + 9])
    ahead = len(made)
    assert ahead <= 2 + 40_000 * programme.TICK_S / min(one.seconds for one in flown.segment)
    np.testing.assert_array_equal(sticks.rows(0, 9), whole[:9])  # powered on anew
    assert len(made) == ahead + 1
