"""What is flown stays within tilt and room, and brings the craft back."""

import math

import numpy as np
import pytest

from groundstation.errors import BadInputError
from groundstation.learn.manoeuvres import (
    BODY,
    GRAVITY,
    HOVER,
    PROOF,
    Limits,
    flight_of,
    library,
    require_limits,
)

LIMITS = [Limits(), Limits(tilt_deg=5.0), Limits(reach_m=0.5, height_m=0.3)]


@pytest.mark.parametrize("limits", LIMITS)
def test_no_manoeuvre_leans_further_than_allowed_or_comes_near_the_ground(limits):
    for one in library(limits).values():
        assert np.abs(one.table[:, :2]).max() <= limits.tilt_deg
        assert limits.height_m + one.table[:, 3].min() >= 0.5 * limits.height_m


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("seed", [1, 2])
def test_every_manoeuvre_stays_in_its_room_and_ends_at_rest_where_nothing_slows_it_down(
    limits, seed
):
    for one in library(limits, seed).values():
        place, velocity, heading = np.zeros(2), np.zeros(2), 0.0
        for roll, pitch, yaw, _ in np.radians(one.table):
            heading += yaw / 100
            ahead, left = GRAVITY * np.tan(pitch), -GRAVITY * np.tan(roll)
            turned = np.cos(heading), np.sin(heading)
            pushed = ahead * turned[0] - left * turned[1], ahead * turned[1] + left * turned[0]
            velocity += np.array(pushed) / 100
            place += velocity / 100
            assert np.hypot(*place) <= limits.reach_m + 0.01, one.name
        assert np.hypot(*velocity) < 0.15, one.name


def test_a_smaller_room_makes_smaller_leans():
    limits = Limits(reach_m=0.5)
    assert limits.lean(30.0, 1.0) < Limits(reach_m=1.0).lean(30.0, 1.0) <= 12.0
    lean = math.radians(limits.lean(30.0, 1.0))
    assert GRAVITY * math.tan(lean) * 1.0**2 <= 0.5 + 1e-9


def test_a_flight_begins_and_ends_level_and_says_when_what_is_flown():
    plan = flight_of(BODY, "the body", Limits(), seed=1)
    table = plan.setpoints()
    assert not table[0].any()
    assert not table[-1].any()
    for row, name in zip(plan.timeline(), BODY, strict=True):
        assert row["fly"] == name
        first = round(100 * row["at_s"])
        moves = table[first : first + round(100 * row["seconds"])]
        assert moves.any()
        assert not table[first - 100 : first].any()


def test_random_levels_are_those_of_the_seed():
    one, same, other = (library(Limits(), seed)["all axes at random"].table for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_every_flight_that_needs_no_model_is_of_the_library():
    assert {*HOVER, *BODY, *PROOF} <= set(library(Limits()))


@pytest.mark.parametrize("limits", [Limits(height_m=0.1), Limits(reach_m=0.2)])
def test_limits_in_which_nothing_can_be_flown_are_refused(limits):
    with pytest.raises(BadInputError, match="--"):
        require_limits(limits)
