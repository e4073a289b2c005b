"""Failsafe, lease, age of setpoints and what follows a stop, on a clock that the test turns."""

import asyncio
import math

import pytest

from groundstation.errors import BadInputError, LinkError, NotAuthorisedError, TakenError
from groundstation.links.command import LIFE_S
from groundstation.service.commander import WATCH_S
from groundstation.service.lease import CHECKS_S, NOT_TOLD, STATE_S, STILL_TURN, STOPPED
from support.worlds import HOVER, Flying

ROUNDING_S = 1e-6


@pytest.fixture
def flying(request, tmp_path):
    made = Flying(getattr(request, "param", "crazyflie21"), tmp_path / "changed.json")
    yield made
    made.world.close()


def thrusts(craft, since_s):
    return [one.value for one in craft.delivered
            if one.kind == "setpoint" and one.at_s > since_s]  # fmt: skip


def test_a_client_that_falls_silent_means_level_and_then_motors_off(flying):
    token = flying.lease()
    flying.commander.setpoint(token, 5.0, 5.0, 0.0, HOVER, None, flying.world.now_s)
    last_s = flying.world.now_s
    flying.wait(0.3)
    assert any("level attitude" in text for text in flying.told)
    assert flying.one.turns
    flying.wait(0.7)
    client, *after = [one for one in flying.one.delivered if one.handed_s >= last_s]
    assert (client.level, client.value) == (False, HOVER)
    assert all(one.level for one in after)
    first_s = {one.value: one.handed_s - last_s for one in reversed(after)}
    assert set(first_s) == {HOVER, 0}
    assert 0.0 <= first_s[HOVER] - 0.2 + ROUNDING_S <= WATCH_S + 2 * ROUNDING_S
    assert 0.0 <= first_s[0] - 0.6 + ROUNDING_S <= WATCH_S + 2 * ROUNDING_S
    thrusts = [one.value for one in after]
    assert thrusts == sorted(thrusts, reverse=True), "thrust comes back after the stop"
    assert not flying.one.turns
    with pytest.raises(NotAuthorisedError, match="no setpoint came in time"):
        flying.commander.setpoint(token, 0, 0, 0, HOVER)


def test_a_hundred_setpoints_a_second_pass_and_a_thousand_do_not(flying):
    token = flying.lease()

    def sent(rate_hz):
        for _ in range(rate_hz * 2):
            flying.commander.setpoint(token, 1.0, 0.0, 0.0, 0)
            flying.world.pass_time(1 / rate_hz)
            flying.commander.turn(flying.world.now_s)

    sent(100)
    with pytest.raises(BadInputError, match="faster than 100 a second"):
        sent(1000)
    flying.wait(1.0)  # one that was held up for a second may catch up
    sent(100)


def test_a_lease_ends_by_the_clock_though_nobody_has_looked(flying):
    token = flying.lease()
    flying.world.pass_time(4.9)
    flying.commander.keep(token)
    flying.world.pass_time(5.1)
    with pytest.raises(NotAuthorisedError, match="silent for 5 s"):
        flying.commander.keep(token)
    assert flying.lease("another"), "an ended lease keeps another client out"


def test_a_setpoint_that_was_made_too_long_ago_is_refused(flying):
    token = flying.lease()
    with pytest.raises(LinkError, match="too old"):
        flying.commander.setpoint(token, 0, 0, 0, HOVER, None, flying.world.now_s - 0.6)
    flying.wait(0.2)
    assert thrusts(flying.one, 0.0) == []


def test_a_setpoint_grows_old_while_the_radio_takes_nothing(flying):
    token = flying.lease()
    flying.steer(token, 0.3, thrust=0)
    flying.one.stalls = True
    begun_s = flying.world.now_s
    flying.commander.setpoint(token, 0, 0, 0, HOVER, None, begun_s)
    flying.world.pass_time(0.55)
    flying.one.stalls = False
    flying.world.pass_time(0.1)
    assert thrusts(flying.one, begun_s) == []
    assert flying.one.outbox.expired == 1


@pytest.mark.parametrize(("stalls_s", "is_sent"), [(0.1, True), (0.3, False)])
def test_a_setpoint_s_age_counts_from_when_it_was_made_and_not_from_its_arrival(
    flying, stalls_s, is_sent
):
    token = flying.lease()
    flying.steer(token, 0.3, thrust=0)
    flying.one.stalls = True
    begun_s = flying.world.now_s
    flying.commander.setpoint(token, 0, 0, 0, HOVER, None, begun_s - LIFE_S + 0.2)
    flying.world.pass_time(stalls_s)
    flying.one.stalls = False
    flying.world.pass_time(0.05)
    assert (thrusts(flying.one, begun_s) == [HOVER]) is is_sent
    assert flying.one.outbox.expired == (not is_sent)


def test_the_failsafe_counts_from_when_the_last_setpoint_was_made_and_not_from_its_arrival(flying):
    """One that waited in a socket, of a client that is dead, flies the craft no longer for that."""
    token = flying.lease()
    flying.steer(token, 0.3)
    made_s = flying.world.now_s - 0.4
    flying.commander.setpoint(token, 5.0, 0.0, 0.0, HOVER, None, made_s)
    flying.wait(1.0)
    after = [one for one in flying.one.delivered if one.handed_s >= made_s + 0.4]
    level_s = min(one.handed_s for one in after if one.level)
    off_s = min(one.handed_s for one in after if one.value == 0)
    assert level_s - made_s <= 0.4 + WATCH_S + ROUNDING_S, "silent for longer than 0.2 s already"
    assert 0.0 <= off_s - made_s - 0.6 + ROUNDING_S <= WATCH_S + 2 * ROUNDING_S


@pytest.mark.parametrize("stood_s", [1.0, 4.0])
def test_what_was_said_before_the_daemon_stood_still_turns_no_motor(flying, stood_s):
    """The client is dead, its setpoint waits in a socket, and its lease may still be in force."""
    token = flying.lease()
    flying.steer(token, 0.3, thrust=0)
    flying.world.pass_time(stood_s)
    for turned in (False, True):  # the loop that wakes may hear it before or after its own clock
        if turned:
            flying.commander.turn(flying.world.now_s)
        for made_s in (None, math.nan, flying.world.now_s + 60.0):  # or of another clock
            with pytest.raises(LinkError, match="stood still"):
                flying.commander.setpoint(token, 0, 0, 0, HOVER, None, made_s)
    flying.commander.setpoint(token, 0, 0, 0, 0)  # no thrust is never too old
    flying.wait(0.6)
    flying.commander.setpoint(token, 0, 0, 0, HOVER)


def tried(craft):
    """What was sent besides setpoints."""
    return [(one.kind, one.value) for one in craft.delivered if one.kind != "setpoint"]


def escalation(flying):
    return [text.partition(": ")[2] for text in flying.told if STILL_TURN in text]


def test_zero_thrust_is_repeated_for_a_quarter_of_a_second_after_a_stop(flying):
    """Where the firmware needs no more of it: a radio may lose some."""
    flying.one.settles_s = 0.0
    asked_s = flying.world.now_s
    assert flying.stopped() == STOPPED
    flying.wait(2.0)
    sent_s = [one.handed_s - asked_s for one in flying.one.delivered
              if one.kind == "setpoint" and one.handed_s >= asked_s]  # fmt: skip
    assert len(sent_s) >= 4
    assert max(sent_s) == pytest.approx(0.25, abs=WATCH_S + ROUNDING_S)


def test_more_is_tried_half_a_second_after_each_try_and_not_before(flying):
    flying.steer(flying.lease(), 0.5)
    flying.one.held, flying.one.craft.emergency_stop = HOVER, lambda: None
    tried_s, asked_s = [], flying.world.now_s
    note = flying.told.append

    class Told(list):
        def append(self, text):
            note(text)
            if STILL_TURN in text:
                tried_s.append(flying.world.now_s - asked_s)

    flying.told = Told()
    assert flying.stopped() == STILL_TURN
    assert tried_s[:3] == pytest.approx([0.5, 1.0, 1.5], abs=2 * WATCH_S + ROUNDING_S)


def test_motors_that_go_on_turning_are_stopped_by_the_firmware(flying):
    """Another program commands the craft, too; a brushed one that is disarmed arms itself again."""
    flying.steer(flying.lease(), 0.5)
    flying.one.held = HOVER
    asked_s = flying.world.now_s
    assert flying.stopped() == STOPPED
    assert tried(flying.one) == [("emergency stop", 1)]
    assert escalation(flying) == ["asked again", "emergency stop"]
    assert 1.0 < flying.world.now_s - asked_s < 1.5
    assert not flying.one.turns


@pytest.mark.parametrize("flying", ["brushless"], indirect=True)
def test_motors_that_are_armed_by_request_are_disarmed_again_before_that(flying):
    flying.run(flying.commander.operator.arm(True))
    flying.steer(flying.lease(), 0.5)
    flying.one.loses = 1
    assert flying.stopped() == STOPPED
    assert tried(flying.one) == [("arm", 1), ("arm", 0), ("arm", 0)]
    assert escalation(flying) == ["disarmed"]
    assert not flying.one.turns


def test_what_is_tried_is_tried_again_and_stopped_is_not_said_before(flying):
    flying.steer(flying.lease(), 0.5)
    flying.one.held, flying.one.craft.emergency_stop = HOVER, lambda: None
    assert flying.stopped() == STILL_TURN
    flying.wait(2.0)
    assert len(tried(flying.one)) >= 4
    assert not any("motors stopped" in text for text in flying.told)


def test_a_daemon_ends_though_the_motors_go_on_turning(flying):
    flying.steer(flying.lease(), 0.5)
    flying.one.held, flying.one.craft.emergency_stop = HOVER, lambda: None
    begun_s = flying.world.now_s
    flying.run(flying.commander.close())
    assert 5.0 < flying.world.now_s - begun_s < 12.0
    assert len(tried(flying.one)) >= 4


def test_nothing_is_known_of_motors_without_telemetry(flying):
    flying.steer(flying.lease(), 0.5)
    flying.one.deaf = True
    assert flying.stopped() == NOT_TOLD


def test_motors_that_stood_before_a_stop_are_not_known_to_stand_after_it(flying):
    flying.steer(flying.lease(), 0.3, thrust=0)
    assert flying.one.motors().duty == 0.0
    flying.one.deaf = True
    assert flying.stopped() == NOT_TOLD
    assert not any("motors stopped" in text for text in flying.told)


def test_a_stop_keeps_the_craft_that_it_was_pressed_for(flying):
    flying.steer(flying.lease(), 0.5)
    flying.one.held = HOVER

    async def press_and_connect():
        asked = asyncio.ensure_future(flying.commander.operator.stop())
        await asyncio.sleep(0.15)
        with pytest.raises(TakenError, match="being stopped"):
            await flying.commander.replace(flying.other)
        leaving = asyncio.ensure_future(flying.commander.leave())
        while not asked.done():
            flying.commander.look(flying.world.now_s)
            assert not (flying.one.turns and leaving.done())
            await asyncio.sleep(WATCH_S)
        assert asked.result() == STOPPED
        flying.one.held = 0
        await leaving
        await flying.commander.replace(flying.other)

    flying.run(press_and_connect())
    assert flying.other.delivered == []
    assert flying.one.delivered[-1].kind in ("setpoint", "emergency stop")


@pytest.mark.parametrize("flying", ["brushless"], indirect=True)
@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.2, 0.4, 0.6])
def test_a_stop_ends_a_request_to_arm(flying, after_s):
    async def arm_and_stop():
        arming = asyncio.ensure_future(flying.commander.operator.arm(True))
        await asyncio.sleep(after_s)
        asked_s = flying.world.now_s
        stopping = asyncio.ensure_future(flying.commander.operator.stop())
        while not (stopping.done() and arming.done()) or flying.world.now_s < asked_s + 3.0:
            flying.commander.look(flying.world.now_s)
            await asyncio.sleep(WATCH_S)
        return arming, stopping.result(), asked_s

    arming, told, asked_s = flying.run(arm_and_stop())
    assert told == STOPPED
    assert arming.exception() is not None
    assert not [one for one in flying.one.delivered
                if one.kind == "arm" and one.value and one.handed_s > asked_s]  # fmt: skip
    state = flying.one.craft.state()
    assert (state.armed, flying.one.turns) == (False, False)


def asked_while_the_radio_takes_nothing(flying, seconds, *after):
    """What an operator asks for and the radio has not taken; what then reached the craft."""

    async def ask():
        asking = [
            asyncio.ensure_future(work) for work in (flying.commander.operator.arm(True), *after)
        ]
        await asyncio.sleep(seconds)
        flying.one.stalls = False
        flying.commander.look(flying.world.now_s)
        await asyncio.sleep(3.5)
        await asyncio.gather(*asking, return_exceptions=True)

    flying.one.stalls = True
    flying.run(ask())
    return [value for kind, value in tried(flying.one) if kind == "arm"]


@pytest.mark.parametrize("flying", ["brushless"], indirect=True)
@pytest.mark.parametrize("disarms", [True, False])  # not where it would be locked by that
def test_a_request_to_arm_that_waits_for_the_radio_is_withdrawn_by_a_stop(
    flying, disarms, monkeypatch
):
    monkeypatch.setattr(type(flying.one), "disarms_in_flight", disarms)
    stop = flying.commander.operator.stop()
    assert asked_while_the_radio_takes_nothing(flying, 0.2, stop) == [0] * disarms
    assert not flying.one.turns


@pytest.mark.parametrize("flying", ["brushless"], indirect=True)
def test_a_request_to_arm_grows_old_while_the_radio_takes_nothing(flying):
    patience_s = CHECKS_S + STATE_S + 2 * LIFE_S  # it is asked again while the operator waits
    assert asked_while_the_radio_takes_nothing(flying, patience_s) == []


@pytest.mark.parametrize("flying", ["brushless"], indirect=True)
def test_a_craft_that_has_not_said_yet_whether_it_is_armed_is_disarmed_by_a_stop(flying):
    flying.run(flying.commander.operator.arm(True))
    flying.one.lose()
    flying.one.connect()
    assert flying.stopped() == STOPPED
    assert tried(flying.one) == [("arm", 1), ("arm", 0)]
    assert escalation(flying) == [], "disarmed at once, not where it still turns"
    assert not flying.one.turns


def test_no_thrust_and_no_arming_while_motors_are_being_stopped(flying):
    token = flying.lease()
    flying.steer(token, 0.5)
    flying.one.held = HOVER

    async def press():
        asked = asyncio.ensure_future(flying.commander.stop_own(token))
        await asyncio.sleep(0.1)
        with pytest.raises(TakenError, match="being stopped"):
            flying.commander.setpoint(token, 0, 0, 0, HOVER)
        with pytest.raises(TakenError, match="being stopped"):
            await flying.commander.operator.arm(True)
        while not asked.done():
            flying.commander.look(flying.world.now_s)
            await asyncio.sleep(WATCH_S)

    flying.run(press())


def test_a_client_that_was_stopped_by_the_operator_is_told_so_and_how_its_motors_are(flying):
    token = flying.lease()
    flying.steer(token, 0.5)
    assert flying.stopped() == STOPPED
    with pytest.raises(NotAuthorisedError, match="the operator has stopped the motors"):
        flying.commander.setpoint(token, 0, 0, 0, HOVER)
    assert flying.run(flying.commander.stop_own(token)) == STOPPED
