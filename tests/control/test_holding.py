"""A craft that is stopped and brought back by what hover setpoints take."""

import dataclasses
import math

import pytest

from groundstation.control.programme import HOLD_MOST_S, NEAR_M, Holding, Hover
from support.flights import HOVERS

ANSWER_S = 0.15
"""How fast the craft of these tests follows a velocity."""


def held(x_m, y_m, vx_m_s, vy_m_s, heading_deg=0.0, wind_m_s=0.0, home=(0.0, 0.0)):
    """(seconds, craft) after a hold of a craft that follows velocities."""
    heading, time_s = math.radians(heading_deg), 0.0
    holding = Holding(home, time_s)
    place, velocity = complex(x_m, y_m), complex(vx_m_s, vy_m_s)
    while True:
        now = dataclasses.replace(
            HOVERS, x_m=place.real, y_m=place.imag, vx_m_s=velocity.real, vy_m_s=velocity.imag,
            heading_rad=heading,
        )  # fmt: skip
        asked = holding.velocity(time_s, now)
        if asked is None:
            return time_s, now
        wanted = complex(*asked) * complex(math.cos(heading), math.sin(heading)) + wind_m_s
        assert abs(complex(*asked)) <= 0.3 + 1e-9
        velocity += (wanted - velocity) * 0.01 / ANSWER_S
        place += velocity * 0.01
        time_s += 0.01


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, -135.0])
def test_it_stops_goes_back_and_rests_whatever_its_heading(heading_deg):
    seconds, craft = held(0.8, -0.5, 0.6, 0.3, heading_deg)
    assert math.hypot(craft.x_m, craft.y_m) < NEAR_M
    assert craft.speed_m_s < 0.1
    assert 3.0 < seconds < HOLD_MOST_S


def test_a_craft_that_is_there_rests_for_half_a_second():
    assert held(0.05, 0.0, 0.0, 0.0)[0] == pytest.approx(0.5)
    assert held(2.05, 1.0, 0.0, 0.0, home=(2.0, 1.0))[0] == pytest.approx(0.5)


def test_a_craft_that_cannot_come_back_is_not_held_for_ever():
    seconds, craft = held(1.0, 0.0, 0.0, 0.0, wind_m_s=0.3)
    assert seconds == pytest.approx(HOLD_MOST_S + 0.5, abs=0.02)
    assert craft.x_m > NEAR_M


def test_trim_and_thrust_of_hover_are_those_of_its_last_second():
    hover = Hover()
    for tick in range(300):
        time_s = 0.01 * tick
        rolls = 10.0 if time_s < 1.9 else 2.0
        now = dataclasses.replace(HOVERS, roll_deg=rolls, pitch_deg=-1.0, thrust=3.0)
        hover.add(time_s, now)
    assert hover.trim_deg == (2.0, -1.0)
    assert hover.thrust == 3.0
