"""What is flown stays within tilt and room, and brings the craft back."""

import math

import numpy as np
import pytest

from groundstation.control.programme import AHEAD_S, GRAVITY, NEAR_M, stands_again
from groundstation.errors import BadInputError
from groundstation.learn.planning import (
    BODY,
    HOVER,
    PROOF,
    Limits,
    flight_of,
    library,
    require_limits,
)
from groundstation.learn.story import step_flight

LIMITS = [Limits(), Limits(tilt_deg=5.0), Limits(reach_m=0.5, height_m=0.3)]


@pytest.mark.parametrize("limits", LIMITS)
def test_a_flight_of_steps_says_how_long_it_takes_where_its_place_is_held(limits):
    (told,) = step_flight(limits).timeline()
    assert told["seconds"] > len(step_flight(limits).setpoints()) * 0.01


@pytest.mark.parametrize("limits", LIMITS)
def test_no_manoeuvre_leans_further_than_allowed_or_comes_near_the_ground(limits):
    for one in library(limits).values():
        assert np.abs(one.table[:, :2]).max() <= limits.tilt_deg
        assert limits.height_m + one.table[:, 3].min() >= 0.5 * limits.height_m


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_craft_can_brake_in_its_room_in_every_manoeuvre_and_ends_at_rest_where_nothing_slows_it(
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
            assert np.hypot(*(place + AHEAD_S * velocity)) <= limits.reach_m - NEAR_M + 0.01
        assert np.hypot(*velocity) < 0.15, one.name


def test_one_that_was_interrupted_goes_on_from_where_a_craft_that_rests_is_not_carried_off():
    table = library(Limits())["to and fro, left and right"].table
    for row in range(0, len(table) - 150, 37):
        begins = stands_again(table, row)
        assert row <= begins <= row + 100, "half a swing further at most"
        place = velocity = 0.0
        for lean in np.radians(table[begins:, 0]):
            velocity += GRAVITY * np.tan(lean) / 100
            place += velocity / 100
            assert abs(place) < 1.2 * (Limits().reach_m - NEAR_M)
    doublets = library(Limits())["roll doublets"].table
    assert stands_again(doublets, 0) == 0
    assert stands_again(doublets, 30) == pytest.approx(100, abs=6)
    pushes = np.vstack([np.zeros((100, 4)), np.tile([5.0, 0.0, 0.0, 0.0], (100, 1))])
    assert stands_again(pushes, 150) == len(pushes), "nothing stops it any more"


def test_a_smaller_room_makes_smaller_leans():
    limits = Limits(reach_m=0.5)
    assert limits.lean(10.0, 0.7) < Limits(reach_m=1.0).lean(10.0, 0.7) <= 10.0
    lean = math.radians(limits.lean(10.0, 0.7))
    assert GRAVITY * math.tan(lean) * 0.7**2 <= 0.5 - NEAR_M


def test_a_flight_says_what_is_flown_about_when_and_has_time_to_come_back_between():
    plan = flight_of(BODY, "the body", Limits(), seed=1)
    rows = plan.timeline()
    assert [row["fly"] for row in rows] == [name for name, _ in plan.parts()] == list(BODY)
    for row, after, (_, table) in zip(rows, rows[1:], plan.parts(), strict=False):
        assert row["seconds"] == len(table) / 100
        assert after["at_s"] >= row["at_s"] + row["seconds"] + 2.0
    assert plan.seconds > rows[-1]["at_s"] + rows[-1]["seconds"]


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
