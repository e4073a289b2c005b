"""Who brings a craft down that holds its height, and what cuts its motors instead, on a clock that
the test turns."""

import asyncio
import contextlib

import pytest

from groundstation.errors import BadInputError, LinkError, NotAuthorisedError, TakenError
from groundstation.links.command import LONGEST_S, CommandState
from groundstation.service.commander import WATCH_S
from groundstation.service.lease import GRACE_S, LANDED, NOT_TOLD, SEEN_S, SILENT_S, STOPPED
from support.worlds import HOVER, Flying

HEIGHT_M = 0.6
STILL = {"vx_m_s": 0.0, "vy_m_s": 0.0}
SOFT_M_S = 0.6
"""As fast as it may meet the ground."""


class Highest(Flying):
    """It keeps the height and the sinking of its craft, in truth."""

    def __init__(self, changes, deck, kind="crazyflie21"):
        super().__init__(kind, changes, deck)
        self.fastest_m_s = self.highest_m = 0.0
        passes = self.one.pass_time

        def passing(to_s):
            passes(to_s)
            state = self.one.craft.state()
            self.highest_m = max(self.highest_m, state.position_m[2])
            self.fastest_m_s = max(self.fastest_m_s, -state.velocity_m_s[2])

        self.one.pass_time = passing

    @property
    def height_m(self):
        return self.one.craft.state().position_m[2]

    def fly(self, token, seconds=4.0):
        self.steer(token, 0.3, thrust=0)
        self.steer(token, seconds, thrust=0, height_m=HEIGHT_M)
        assert self.height_m == pytest.approx(HEIGHT_M, abs=0.2)
        self.fastest_m_s = 0.0

    def until_down(self):
        """How long it takes until no rotor turns."""
        begun_s = self.world.now_s
        while self.one.turns and self.world.now_s < begun_s + 20.0:
            self.wait(WATCH_S)
        return self.world.now_s - begun_s

    def says(self, height_m, tilt_deg):
        """Of itself, from now on: at rest, so high, leaning by so much."""
        place = type(self.one._place(self.one.craft.state()))
        self.one._place = lambda _: place(0, 0, height_m, 0, 0, 0, tilt_deg, self.world.now_s)

    def has_landed(self):
        return self.height_m < 0.1 and self.fastest_m_s < SOFT_M_S and not self.one.turns


@pytest.fixture(params=["flow_deck", "height_deck"])
def flying(request, tmp_path):
    made = Highest(tmp_path / "changed.json", request.param)
    yield made
    made.world.close()


def test_a_client_that_vanishes_at_a_height_means_level_and_then_a_landing(flying):
    token = flying.lease()
    flying.fly(token)
    last_s = flying.world.now_s
    took_s = flying.until_down()
    assert flying.has_landed(), (flying.height_m, flying.fastest_m_s)
    assert 1.0 < took_s < flying.commander.limits.stop_s + LONGEST_S + 1.0
    after = [one for one in flying.one.delivered if one.handed_s >= last_s + 0.2]
    assert all(one.level for one in after)
    heights = [one.height_m for one in after if one.height_m is not None]
    assert heights == sorted(heights, reverse=True)
    assert any(one.hovers for one in after) is flying.one.holds_place, "it is not stopped sideways"
    with pytest.raises(NotAuthorisedError, match="no setpoint came in time: the craft is landed"):
        flying.commander.setpoint(token, 0, 0, 0, 0, HEIGHT_M)
    assert any("being landed" in text for text in flying.told)


def test_a_client_that_is_back_while_its_craft_is_landed_neither_flies_nor_drops_it(flying):
    token = flying.lease()
    flying.fly(token)
    flying.wait(1.2)
    for thrust, height_m in ((0, HEIGHT_M), (0, None), (HOVER, None)):
        with pytest.raises(NotAuthorisedError, match="no setpoint came in time"):
            flying.commander.setpoint(token, 0, 0, 0, thrust, height_m)
    with pytest.raises(TakenError, match="being landed"):
        flying.lease("another")
    assert flying.looked(flying.commander.stop_own(token)) == LANDED
    assert flying.has_landed()
    assert flying.lease("another")


def test_a_lease_that_is_released_in_flight_ends_with_a_landing(flying):
    token = flying.lease()
    flying.fly(token)
    flying.commander.release(token)
    flying.until_down()
    assert flying.has_landed()


@pytest.mark.parametrize("after_s", [0.15, 0.3, 0.5, 1.0])
@pytest.mark.parametrize("climb_m_s", [0.4, 100.0])
@pytest.mark.parametrize("ends", ["release", "silence"])
def test_a_landing_after_a_take_off_first_ends_the_climb(tmp_path, ends, climb_m_s, after_s):
    """A Brushless climbs on: with less asked for than it has it sinks with 0.8 to 1.1 m/s."""
    flying = Highest(tmp_path / "changed.json", "flow_deck", "brushless")
    with contextlib.closing(flying.world):
        flying.looked(flying.commander.operator.arm(True))
        token, begun_s = flying.lease(), flying.world.now_s
        while (flown_s := flying.world.now_s - begun_s) < after_s:
            flying.steer(token, 0.02, thrust=0, height_m=min(0.3, climb_m_s * flown_s))
        if ends == "release":
            flying.commander.release(token)
        flying.until_down()
        assert 0.1 < flying.highest_m < 1.1
        assert flying.has_landed(), (flying.height_m, flying.fastest_m_s)


def test_a_client_has_its_craft_landed_and_keeps_its_lease(flying):
    token = flying.lease()
    flying.fly(token)
    assert flying.looked(flying.commander.land_own(token)) == LANDED
    assert flying.has_landed()
    flying.fly(token)
    assert flying.highest_m > 0.4


def test_a_client_may_stop_the_motors_of_its_own_landing(flying):
    token = flying.lease()
    flying.fly(token)

    async def twice():
        landing = asyncio.ensure_future(flying.commander.land_own(token))
        end_s = flying.world.now_s + 0.8
        while flying.world.now_s < end_s:
            flying.commander.look(flying.world.now_s)
            await asyncio.sleep(WATCH_S)
        for thrust, height_m in ((0, HEIGHT_M), (0, None), (HOVER, None)):
            with pytest.raises(TakenError, match="being landed"):
                flying.commander.setpoint(token, 0, 0, 0, thrust, height_m, flying.world.now_s)
        assert await flying.commander.stop_own(token) == STOPPED
        return await landing

    assert flying.looked(twice()) == STOPPED
    assert not flying.one.turns


def test_an_operator_lands_whoever_flies_and_that_lease_is_over(flying):
    token, stops = flying.lease(), flying.commander.operator.stops
    flying.fly(token)
    assert flying.looked(flying.commander.operator.land()) == LANDED
    assert flying.has_landed()
    assert flying.commander.operator.stops == stops + 1
    with pytest.raises(NotAuthorisedError, match="the operator has landed the craft"):
        flying.commander.setpoint(token, 0, 0, 0, 0, HEIGHT_M)
    with pytest.raises(NotAuthorisedError, match="Motors were stopped since this program began"):
        flying.commander.acquire("a program", stops)
    assert flying.looked(flying.commander.land_own(token)) == LANDED, "what it is told behind it"


def test_a_stop_ends_a_landing_at_once(flying):
    flying.fly(flying.lease())

    async def land_and_stop():
        landing = asyncio.ensure_future(flying.commander.operator.land())
        await asyncio.sleep(0.5)
        flying.commander.look(flying.world.now_s)
        asked_s = flying.world.now_s
        assert await flying.commander.operator.stop() == STOPPED
        assert flying.world.now_s - asked_s < 0.5
        return await landing

    assert flying.looked(land_and_stop()) == STOPPED
    assert not flying.one.turns


def test_a_daemon_that_ends_lands_the_craft_first(flying):
    flying.fly(flying.lease())
    flying.run(flying.commander.close())
    assert flying.has_landed()
    assert flying.one.state is CommandState.CLOSED


def test_a_craft_is_landed_though_the_event_loop_stands_still(flying):
    """Nothing but the failsafe's clock turns."""
    flying.fly(flying.lease())
    for _ in range(round((LONGEST_S + 2.0) / WATCH_S)):
        flying.world.pass_time(WATCH_S)
        flying.commander.look(flying.world.now_s)
    assert flying.has_landed()


def test_a_craft_that_says_nothing_any_more_is_not_landed_blind(flying):
    flying.fly(flying.lease())
    flying.one.deaf = True
    since_s = flying.world.now_s
    flying.wait(SILENT_S + flying.commander.limits.stop_s + GRACE_S)
    zero_s = next(one.handed_s for one in flying.one.delivered
                  if one.handed_s > since_s and not one.flies)  # fmt: skip
    assert zero_s - since_s == pytest.approx(SILENT_S, abs=3 * WATCH_S)
    assert any("does not say where it is" in text for text in flying.told)


def test_a_craft_that_tumbles_while_it_is_landed_has_its_motors_cut(flying):
    token = flying.lease()
    flying.fly(token)
    flying.commander.release(token)
    flying.says(0.5, 51.0)
    flying.wait(0.3)
    assert not flying.one.turns
    assert any("leans by 51 degrees" in text for text in flying.told)


def test_a_craft_that_leans_too_far_cannot_be_landed_and_its_client_s_land_stops_it(flying):
    token = flying.lease()
    flying.fly(token)
    flying.says(0.5, 60.0)
    flying.wait(0.06)
    with pytest.raises(BadInputError, match="leans by 60 degrees"):
        flying.run(flying.commander.operator.land())
    assert flying.looked(flying.commander.land_own(token)) == STOPPED


def test_a_link_that_is_lost_while_the_craft_is_landed_is_said_and_tried_no_more(flying):
    token = flying.lease()
    flying.fly(token)
    flying.commander.release(token)
    flying.wait(0.3)
    flying.one.lose()
    flying.wait(SEEN_S + 0.3)
    assert not flying.commander.lands
    assert NOT_TOLD in flying.told


@pytest.mark.parametrize("who", ["nobody", "a client that has not taken off", "its own client"])
def test_land_begins_no_motor_of_a_craft_that_does_not_fly(flying, who):
    """It may be in somebody's hand, a metre above the floor."""
    flying.says(1.0, 0.0)
    land = flying.commander.operator.land
    if who != "nobody":
        token = flying.lease()
        flying.steer(token, 0.3, thrust=0)
        if who == "its own client":
            land = lambda: flying.commander.land_own(token)  # noqa: E731
    flying.wait(0.1)
    assert flying.looked(land()) == STOPPED
    flying.wait(1.0)
    assert not any(one.flies for one in flying.one.delivered)


@pytest.mark.parametrize("stood_s", [1.8, 4.0])
def test_a_daemon_that_stood_still_for_long_lands_nothing_when_it_wakes(flying, stood_s):
    """The firmware stops the motors meanwhile, and somebody may have picked the craft up."""
    token = flying.lease()
    flying.fly(token)
    flying.world.pass_time(stood_s)
    woke_s = flying.world.now_s
    flying.wait(2.0)
    assert not any(one.flies for one in flying.one.delivered if one.handed_s >= woke_s)
    assert not flying.one.turns


def test_a_daemon_that_stood_still_for_a_second_lands_the_craft(flying):
    token = flying.lease()
    flying.fly(token)
    flying.world.pass_time(1.2)
    flying.until_down()
    assert flying.has_landed()


def test_a_craft_on_the_floor_whose_client_vanishes_does_not_leave_it(flying):
    token = flying.lease()
    flying.steer(token, 0.3, thrust=0)
    flying.steer(token, 0.15, thrust=20000)
    flying.until_down()
    assert flying.highest_m < 0.05
    assert not flying.one.turns


def test_no_thrust_of_a_client_is_not_a_flight_that_would_be_landed(flying):
    token = flying.lease()
    flying.fly(token)
    sent_s = flying.world.now_s
    flying.commander.setpoint(token, 0, 0, 0, 0)
    flying.commander.release(token)
    flying.wait(1.0)
    assert not any(one.flies for one in flying.one.delivered if one.handed_s > sent_s)


def test_a_craft_that_holds_no_height_is_stopped_and_an_operator_is_told_so(tmp_path):
    flying = Flying("crazyflie21", tmp_path / "changed.json")
    token = flying.lease()
    flying.steer(token, 0.5)
    stops = flying.commander.operator.stops
    with pytest.raises(BadInputError, match="holds no height"):
        flying.run(flying.commander.operator.land())
    assert flying.commander.operator.stops == stops
    assert flying.commander.client == "a program"
    assert flying.looked(flying.commander.land_own(token)) == STOPPED
    flying.commander.keep(token)
    flying.world.close()


def test_velocities_are_refused_where_they_are_not_held(flying):
    token = flying.lease()

    def send(**values):
        flying.commander.setpoint(token, 0.0, 0.0, 0.0, 0, made_s=flying.world.now_s, **values)

    if flying.one.holds_place:
        send(height_m=0.1, **STILL)
    else:
        with pytest.raises(BadInputError, match="holds no velocity"):
            send(height_m=0.1, **STILL)
    for bad in (
        {"vx_m_s": 0.1, "height_m": 0.5},
        {"vx_m_s": 0.1, "vy_m_s": 2.1, "height_m": 0.5},
        STILL,
    ):
        with pytest.raises(BadInputError, match=r"vx_m_s|vy_m_s"):
            send(**bad)
    with pytest.raises(BadInputError, match="not both"):
        flying.commander.setpoint(token, 5.0, 0.0, 0.0, 0, 0.5, flying.world.now_s, 0.0, 0.0)


def test_what_a_program_begun_before_a_stop_asks_for_is_refused(flying):
    stops = flying.commander.operator.stops
    assert flying.commander.acquire("a program", stops).stops == stops
    flying.stopped()
    with pytest.raises(NotAuthorisedError, match="Begin it again"):
        flying.commander.acquire("a program", stops)
    assert flying.commander.acquire("a program", stops + 1)


def test_a_stop_counts_though_the_craft_is_not_connected(flying):
    stops = flying.commander.operator.stops
    flying.one.lose()
    with pytest.raises(LinkError, match="not connected"):
        flying.run(flying.commander.operator.stop())
    flying.one.connect()
    with pytest.raises(NotAuthorisedError, match="Begin it again"):
        flying.commander.acquire("a program", stops)


def test_nobody_commands_while_motors_are_being_stopped(flying):
    token = flying.lease()
    flying.steer(token, 0.3, thrust=0)
    flying.steer(token, 0.3)
    flying.one.held = HOVER

    async def press():
        asked = asyncio.ensure_future(flying.commander.operator.stop())
        await asyncio.sleep(0.1)
        with pytest.raises(TakenError, match="being stopped"):
            flying.lease("another")
        while not asked.done():
            flying.commander.look(flying.world.now_s)
            await asyncio.sleep(WATCH_S)

    flying.run(press())
