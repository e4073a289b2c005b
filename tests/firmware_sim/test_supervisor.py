"""The supervisor of the software craft, as the firmware's own sources describe it."""

from __future__ import annotations

import pytest

from firmware_sim.contents import supervisor_bits
from firmware_sim.craft import StandIn
from firmware_sim.crtp import Conversation
from firmware_sim.supervisor import CRASHED, FLYING, LANDED, LOCKED, NOT_PASSED, PASSED, READY
from support.plant import craft_after

HOVER = 34000
ARMED, CAN_ARM, CAN_FLY, TUMBLED, IS_LOCKED = 2, 1, 8, 32, 64


def ready(**settings) -> StandIn:
    craft = craft_after(
        3.0,
        **{"craft": "brushless", "program": "wait", "resume_s": 1e6, "plant": "reduced"} | settings,
    )
    return craft


def steered(craft: StandIn, seconds: float, thrust: int | None) -> int:
    """The supervisor's state behind so long with these setpoints, or with none."""
    for _ in range(round(seconds / 0.02)):
        if thrust is not None:
            craft.command(0.0, 0.0, 0.0, thrust)
        craft.advance(craft.time_s + 0.02)
    return craft.state().supervisor


def flown(seconds: float = 1.0, **settings) -> StandIn:
    craft = ready(**settings)
    assert craft.arm(True)
    steered(craft, 0.2, 0)
    assert steered(craft, seconds, HOVER) == FLYING
    return craft


def test_setpoints_that_cease_in_flight_lock_the_craft_and_its_console_says_so():
    craft = flown()
    client = Conversation(craft)
    assert steered(craft, 2.3, None) == LOCKED
    assert client.due(craft.uptime_ms)[0] == b"\0SUP: Locked, reboot required\n"
    assert not craft.arm(True)
    steered(craft, 0.2, 0)
    steered(craft, 1.0, HOVER)
    assert not any(craft.state().motors)
    assert supervisor_bits(craft.state()) == IS_LOCKED


def test_zero_thrust_must_go_on_until_the_craft_calls_itself_landed():
    # a hop, from which it comes down on its feet
    ceases_at_once, goes_on = flown(0.3), flown(0.3)
    steered(ceases_at_once, 0.3, 0)
    steered(goes_on, 2.5, 0)
    assert goes_on.state().supervisor == LANDED
    assert steered(ceases_at_once, 3.0, None) == LOCKED
    assert steered(goes_on, 3.2, None) == PASSED
    assert goes_on.arm(True)
    assert steered(goes_on, 0.1, 0) == READY


@pytest.mark.parametrize(("protocol", "state"), [(7, LOCKED), (8, LOCKED), (9, NOT_PASSED)])
def test_disarming_in_flight_locks_what_was_released_before_2025(protocol, state):
    craft = flown(protocol=protocol)
    assert craft.arm(False)
    while (now := craft.state().supervisor) == FLYING:
        steered(craft, 0.02, HOVER)
    assert now == state
    assert not any(craft.state().motors)


@pytest.mark.parametrize(
    ("settings", "state"),
    [
        ({"protocol": 7}, LOCKED),
        ({"protocol": 7, "software_build": True, "craft": "crazyflie21"}, CRASHED),
        ({"protocol": 10}, CRASHED),
    ],
)
def test_a_craft_that_lies_on_its_back_after_a_flight_has_crashed(settings, state):
    """On protocol 7 too with the firmware of April 2024, which is built to run in software."""
    craft = flown(gains={"pid_rate.roll_kp": 0.0, "pid_rate.roll_ki": 0.0}, **settings)
    for _ in range(200):
        craft.command(30.0, 0.0, 0.0, HOVER)
        craft.advance(craft.time_s + 0.02)
        craft._state[0]["y"][6:10] = 0.0, 1.0, 0.0, 0.0  # turned over, as by a wall
        if craft.state().supervisor != FLYING:
            break
    assert craft.state().supervisor == state
    assert not craft.recover() or state == LOCKED


def test_a_craft_on_its_back_cannot_be_armed_until_it_is_set_upright():
    craft = ready(upside_down=True)
    assert supervisor_bits(craft.state()) == TUMBLED
    assert not craft.arm(True)
    upright = ready()
    assert supervisor_bits(upright.state()) == CAN_ARM
    assert upright.arm(True)
    assert supervisor_bits(upright.state()) & ARMED


@pytest.mark.parametrize("kind", ["crazyflie21", "brushless"])
def test_nothing_is_armed_before_the_gyros_bias_has_been_found(kind):
    craft = craft_after(1.0, craft=kind, program="wait", resume_s=1e6, plant="reduced")
    assert not craft.state().calibrated
    assert supervisor_bits(craft.state()) & (CAN_ARM | ARMED | CAN_FLY) == 0
    assert not craft.arm(True)
    craft.advance(3.0)
    assert craft.state().calibrated
    assert craft.arm(True)


def test_the_motors_of_an_armed_brushless_idle_and_it_does_not_call_that_flying():
    craft = ready()
    assert not any(craft.state().motors)
    assert craft.arm(True)
    assert steered(craft, 2.5, 0) == READY
    assert set(craft.state().motors) == {7000}
    assert steered(craft, 1.0, HOVER) == FLYING
    assert steered(craft, 2.5, 0) == LANDED
    assert set(craft.state().motors) == {7000}
    assert craft.arm(False)
    steered(craft, 0.1, 0)
    assert not any(craft.state().motors)


def test_a_brushless_that_does_not_fly_is_disarmed_after_30_s_and_a_brushed_one_arms_itself():
    for craft, armed in ((ready(), False), (ready(craft="crazyflie21"), True)):
        assert craft.arm(True)
        steered(craft, 0.1, 0)
        craft.advance(craft.time_s + 31.0)
        assert craft.state().armed is armed
