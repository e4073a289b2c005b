"""Stability margins, against figures worked out independently and against flights."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_sim.craft import StandIn, StandInSettings
from support.loop_margins import HOLD_S, loop_margins

STOCK_ON_THESIS = {
    "pid_rate.roll_kp": 70.0,
    "pid_rate.pitch_kp": 70.0,
    "pid_attitude.roll_kp": 3.5,
    "pid_attitude.pitch_kp": 3.5,
}


def test_the_thesis_craft_with_stock_gains_has_no_phase_left_for_its_sensor():
    settings = StandInSettings(craft="thesis", gains=STOCK_ON_THESIS)
    ideal = loop_margins(settings, "roll", age_s=-HOLD_S, angle_loop=False)
    assert ideal.crossover_rad_s == pytest.approx(48, rel=0.06)
    assert ideal.phase_deg == pytest.approx(11, abs=1)
    assert loop_margins(settings, "roll").phase_deg == pytest.approx(-4, abs=2)


@pytest.mark.parametrize("craft", ["crazyflie1", "crazyflie21", "thesis"])
@pytest.mark.parametrize("axis", ["roll", "yaw"])
def test_every_craft_has_margins_at_its_default_gains(craft, axis):
    margins = loop_margins(StandInSettings(craft=craft), axis)
    assert margins.phase_deg > 4
    assert margins.delay_s > 3e-3
    assert margins.gain > 1.7


def worst_rate(**settings) -> float:
    craft = StandIn(StandInSettings(program="hover", truth=True, copies=1, **settings))
    craft.advance(14.0)
    return float(np.abs(craft.truth()["rate_rad_s"][3500:]).max())


def test_a_craft_without_margin_oscillates_and_one_with_margin_does_not():
    assert worst_rate(craft="thesis") < 1.5
    assert worst_rate(craft="thesis", gains=STOCK_ON_THESIS) > 3.0


def test_the_delay_margin_is_where_flights_begin_to_oscillate():
    margin = loop_margins(StandInSettings(plant="reduced"), "roll", age_s=0.0).delay_s
    rates = [
        worst_rate(plant="reduced", effects={"dead_time": {"delay_s": scale * margin}})
        for scale in (0.5, 1.5)
    ]
    assert rates[0] < 1.5
    assert rates[1] > 3.0
