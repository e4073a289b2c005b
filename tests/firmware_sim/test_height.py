"""A craft with a Z-ranger holds the height that it is asked for."""

import struct

import numpy as np
import pytest

from firmware_sim.crtp import Conversation
from support.plant import craft_after

HEADER = 7 << 4
STEP_S = 0.01


def flown(craft_name, packets, parameters=(), **settings):
    """Position (m), angles (deg) and thrust after each packet, 100 a second."""
    craft = craft_after(
        3.0, craft=craft_name, program="wait", resume_s=1e6, seed=4,
        **{"height_deck": True, **settings},
    )  # fmt: skip
    for name, value in parameters:
        craft.set_parameter(name, value)
    craft.arm(True)
    talk, rows = Conversation(craft), []
    for k, packet in enumerate(packets):
        talk.answer(packet)
        craft.advance(3.0 + STEP_S * (k + 1))
        said = craft.state()
        rows.append((*said.position_m, *said.angles_deg, said.thrust, said.height_m))
    return np.array(rows)


def at_height(height_m, roll=0.0, pitch=0.0, yaw=0.0, kind=9):
    return bytes([HEADER]) + struct.pack("<Bffff", kind, roll, pitch, yaw, height_m)


def climb(height_m, steps):
    return [at_height(min(0.4 * STEP_S * k, height_m)) for k in range(steps)]


@pytest.mark.parametrize("craft", ["crazyflie21", "crazyflie21plus", "brushless"])
def test_it_climbs_there_stays_while_it_leans_and_comes_down(craft):
    leaning = [at_height(0.6, roll=10.0 if k < 50 else -10.0) for k in range(100)]
    landing = [at_height(max(0.6 - 0.4 * STEP_S * k, 0.0)) for k in range(200)]
    stop = [bytes([3 << 4]) + struct.pack("<fffH", 0, 0, 0, 0)] * 50
    flight = flown(craft, [*climb(0.6, 500), *leaning, *landing, *stop])
    assert flight[400:600, 2] == pytest.approx(0.6, abs=0.06)
    assert flight[520:550, 3].max() > 8.0
    assert flight[570:600, 3].min() < -8.0
    assert flight[799, 2] == pytest.approx(0.0, abs=0.02)
    assert np.abs(flight[:, 2] - flight[:, 7]).max() < 0.02
    assert flight[780, 6] >= 20000
    assert flight[-1, 6] == 0


@pytest.mark.parametrize(("least", "it_stays"), [(20000.0, False), (15000.0, True)])
def test_a_light_craft_whose_least_thrust_carries_it_rises_beyond_what_was_asked(least, it_stays):
    light = {"mass_change": {"percent": -8.0}}
    sinking = [("posCtlPid.thrustMin", least)]
    height_m = flown("brushless", climb(0.5, 500), sinking, effects=light)[:, 2]
    if it_stays:
        assert height_m.max() < 0.6
        assert height_m[-1] == pytest.approx(0.5, abs=0.02)
    else:
        assert height_m.max() > 1.0


@pytest.mark.parametrize(("kind", "turned"), [(9, 1.0), (2, -1.0)])
def test_pitch_is_nose_up_and_the_older_packet_turns_the_other_way(kind, turned):
    turning = [at_height(0.5, pitch=6.0, yaw=40.0, kind=kind)] * 60
    flight = flown("crazyflie21", [*climb(0.5, 250), *turning])
    assert flight[-1, 4] > 4.0
    assert turned * (flight[-1, 5] - flight[250, 5]) > 15.0


def test_without_a_deck_nothing_flies():
    assert flown("crazyflie21", climb(0.5, 200), height_deck=False)[:, 6].max() == 0


def test_a_client_that_falls_silent_is_levelled_and_then_stopped():
    lean = [at_height(0.5, roll=10.0)] * 30
    flight = flown("crazyflie21", [*climb(0.5, 250), *lean, *[b""] * 300])
    assert flight[280:320, 3].max() > 8.0
    assert abs(flight[400, 3]) < 3.0
    assert flight[450, 2] == pytest.approx(0.5, abs=0.1)
    assert flight[-1, 6] == 0


def with_althold(seconds_and_thrust, **settings):
    """Height (m) and the least motor setting behind each stretch of setpoints."""
    craft = craft_after(
        3.0, craft="crazyflie21", program="wait", resume_s=1e6, plant="reduced", seed=4, **settings
    )
    craft.set_parameter("flightmode.althold", 1.0)
    said = []
    for seconds, thrust in seconds_and_thrust:
        for _ in range(round(seconds / STEP_S)):
            craft.command(0.0, 0.0, 0.0, thrust)
            craft.advance(craft.time_s + STEP_S)
        said.append((craft.state().position_m[2], min(craft.state().motors)))
    craft.set_parameter("flightmode.althold", 0.0)
    for _ in range(10):
        craft.command(0.0, 0.0, 0.0, 0)
        craft.advance(craft.time_s + STEP_S)
    assert not any(craft.state().motors)
    return said


@pytest.mark.parametrize("settings", [{"protocol": 12}, {"protocol": 7, "software_build": True}])
def test_with_althold_thrust_is_a_rate_of_climb_and_at_zero_the_motors_turn(settings):
    """The firmware of April 2024 rises 0.79 m in 2.5 s of 45000, holds that at 32767, and at zero
    thrust lets its motors run on the ground until the mode is left."""
    said = with_althold([(2.5, 45000), (2.0, 32767), (3.0, 0)], **settings)
    (climbed, _), (held, _), (landed, turning) = said
    assert 0.75 < climbed < 1.3
    assert held == pytest.approx(climbed, abs=0.05)
    assert landed == pytest.approx(0.0, abs=0.01)
    assert turning > 10000


def test_with_althold_a_thrust_below_the_middle_does_not_take_off():
    ((height, turning),) = with_althold([(3.0, 30000)])
    assert height == pytest.approx(0.0, abs=0.01)
    assert turning > 10000
