"""A landing in fast time: a height that follows what is asked for, with a lag."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import pytest

from groundstation.links.command import GROUND_S, LONGEST_S, SINK_M_S, Landing

TICK_S = 0.05
LAG_S = 0.3


@dataclass
class Craft:
    """floor_m: where it stands, by its own reckoning. stuck_m: what it says of its height."""

    height_m: float
    floor_m: float = 0.0
    stuck_m: float | None = None
    speed_m_s: float = 0.0

    def follow(self, asked_m: float) -> None:
        wanted_m_s = max(-1.0, min(1.0, (asked_m - self.height_m) / LAG_S))
        self.speed_m_s += (wanted_m_s - self.speed_m_s) * TICK_S / 0.15
        self.height_m += self.speed_m_s * TICK_S
        if self.height_m <= self.floor_m:
            self.height_m, self.speed_m_s = self.floor_m, 0.0

    @property
    def said_m(self) -> float:
        return self.height_m if self.stuck_m is None else self.stuck_m


def landed(craft: Craft, asked_m: float | None, **said: float) -> tuple[float, float, str]:
    """How long it took, how fast it sank at the end, and why it was over."""
    begun = Landing(10.0, asked_m, craft.said_m)
    now_s, fastest_m_s = 10.0, 0.0
    while (height_m := begun.tick(now_s, craft.said_m, **said)) is not None:
        craft.follow(height_m)
        if craft.height_m < 0.3:
            fastest_m_s = max(fastest_m_s, -craft.speed_m_s)
        now_s += TICK_S
    return now_s - 10.0, fastest_m_s, begun.over


@pytest.mark.parametrize("height_m", [0.2, 0.5, 1.0, 1.6, 2.0, 3.0])
def test_a_craft_is_on_the_floor_within_six_seconds_and_slow_there(height_m: float) -> None:
    craft = Craft(height_m)
    took_s, sank_m_s, why = landed(craft, height_m)
    assert why == "it is on the floor"
    assert craft.height_m <= 0.05
    assert took_s <= LONGEST_S + TICK_S
    assert sank_m_s <= 0.4
    if height_m <= 1.6:
        assert took_s >= (height_m - 0.05) / SINK_M_S - TICK_S


def test_the_height_that_is_asked_for_never_rises_and_sinks_slowly_near_the_floor() -> None:
    for height_m in (0.5, 1.59, 1.61, 3.0):
        one = Landing(0.0, height_m)
        asked = [one.asked_m(TICK_S * tick) for tick in range(round(LONGEST_S / TICK_S) + 1)]
        steps = [before - after for before, after in itertools.pairwise(asked)]
        assert asked[0] == height_m
        assert min(steps) >= 0.0
        low = [step for step, before in zip(steps, asked[:-1], strict=True) if before <= 0.59]
        assert max(low) <= SINK_M_S * TICK_S + 1e-9
        assert one.asked_m(LONGEST_S - GROUND_S + 1e-6) == 0.0


def test_a_craft_that_has_not_left_the_floor_is_not_kept_there_with_its_motors_on() -> None:
    assert landed(Craft(0.02), 0.1)[0] == 0.0


def test_a_craft_over_a_table_stands_there_and_is_left() -> None:
    craft = Craft(1.0, floor_m=0.7)
    took_s, _, why = landed(craft, 1.0)
    assert why == "it stands on something"
    assert craft.height_m == 0.7
    assert took_s < 4.0


def test_a_craft_that_still_climbs_is_not_taken_for_one_that_stands() -> None:
    craft = Craft(0.3, speed_m_s=1.0)
    _, sank_m_s, why = landed(craft, 1.0)
    assert why == "it is on the floor"
    assert sank_m_s <= 0.5


def test_it_begins_where_the_craft_is_and_not_where_it_was_asked_to_be() -> None:
    assert Landing(0.0, 2.0, 0.3).asked_m(0.0) == 0.3
    assert Landing(0.0, 0.6, 0.5).asked_m(0.0) == 0.6
    assert Landing(0.0, None, 0.8).asked_m(0.0) == 0.8


def test_a_craft_that_does_not_say_how_high_it_is_is_down_when_its_time_is_up() -> None:
    one, now_s = Landing(0.0, 0.6), 0.0
    while one.tick(now_s) is not None:
        now_s += TICK_S
    assert now_s == pytest.approx(0.6 / SINK_M_S + GROUND_S, abs=2 * TICK_S)
    assert one.over == "its time is up"


def test_a_stuck_height_does_not_keep_the_motors_on() -> None:
    took_s, _, why = landed(Craft(1.0, stuck_m=0.3), 0.3)
    assert (why, took_s < LONGEST_S) == ("it stands on something", True)


def test_a_fast_turn_near_the_floor_is_the_ground_and_in_the_air_it_is_not() -> None:
    craft = Craft(0.5)
    took_s, _, why = landed(craft, 0.5, turns_dps=200.0)
    assert why == "it has met the ground"
    assert took_s == pytest.approx((0.5 - 0.15) / SINK_M_S, abs=2 * TICK_S)
    assert not math.isnan(craft.height_m)


@pytest.mark.parametrize("height_m", [0.1, 0.3, 0.5, 2.0])
def test_a_time_that_was_read_before_it_began_is_its_beginning(height_m: float) -> None:
    begun = Landing(10.0, height_m, height_m)
    assert begun.tick(9.999, height_m) == pytest.approx(height_m)


def test_a_craft_that_is_higher_than_was_asked_for_is_not_dropped_from_there() -> None:
    """One that overshoots, say: 0.3 m was asked for, it is at 0.58 m and still climbs."""
    craft = Craft(0.58, speed_m_s=0.6)
    begun, now_s = Landing(10.0, 0.3, craft.said_m), 10.0
    while (height_m := begun.tick(now_s, craft.said_m)) is not None:
        craft.speed_m_s = max(craft.speed_m_s - 1.0 * TICK_S, -0.3)
        craft.height_m += craft.speed_m_s * TICK_S
        now_s += TICK_S
        assert height_m <= 0.3
    assert craft.height_m <= 0.05


def test_a_craft_that_is_just_leaving_the_floor_is_not_cut_there() -> None:
    begun = Landing(10.0, 0.1, 0.01)
    assert begun.tick(10.0, 0.01, climb_m_s=0.5) is not None
    assert begun.tick(10.05, 0.01, climb_m_s=0.0) is None
