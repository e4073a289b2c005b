"""A craft with a Flow deck flies as the real firmware was measured to fly."""

from __future__ import annotations

import math
import struct
import time

import cflib.crtp
import numpy as np
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.crtp import Conversation
from firmware_sim.physics import present_effects
from firmware_sim.supervisor import FLYING, LEVEL_OUT, LOCKED
from support.crafts import served
from support.waiting import until

STEP_S = 0.02
READY_S = 3.0
CRAFTS = ("crazyflie21", "crazyflie21plus", "brushless")


class Flight:
    """A craft in fast time, commanded 50 times a second."""

    def __init__(self, craft: str = "crazyflie21plus", **settings):
        given = {"flow_deck": True, "seed": 3, "program": "wait", "resume_s": 1e6, **settings}
        self.craft = StandIn(StandInSettings(craft=craft, **given))
        self.now_s = READY_S
        self.craft.advance(self.now_s)
        self.craft.arm(True)

    def hold(self, seconds, command=lambda: None):
        """The state after ``seconds`` of a command."""
        for _ in range(round(seconds / STEP_S)):
            command()
            self.now_s += STEP_S
            self.craft.advance(self.now_s)
        return self.craft.state()

    def up(self, attitude=False):
        """Climb to 0.5 m with 0.4 m/s, under hover setpoints or level ones."""
        for k in range(300):
            fly = self.lean if attitude else self.hover
            fly(STEP_S, height_m=min(0.4 * STEP_S * k, 0.5))
        return self.craft.state()

    def hover(self, seconds, ahead=0.0, left=0.0, yaw=0.0, height_m=0.5):
        return self.hold(seconds, lambda: self.craft.command_hover(ahead, left, yaw, height_m))

    def lean(self, seconds, roll=0.0, pitch=0.0, height_m=0.5):
        return self.hold(seconds, lambda: self.craft.command_height(roll, pitch, 0.0, height_m))

    def push(self):
        """8 degrees to the right for 0.6 s."""
        self.up()
        self.lean(0.6, roll=8.0)

    @property
    def true_roll_deg(self):
        w, a, b, c = self.craft._state[0]["y"][6:10]
        return math.degrees(math.atan2(2 * (b * c + w * a), 1 - 2 * (a * a + b * b)))


def speed(state):
    return math.hypot(*state.velocity_m_s[:2])


@pytest.mark.parametrize("craft", CRAFTS)
def test_level_setpoints_leave_it_its_speed_and_hover_setpoints_take_it(craft):
    """Measured on the firmware of August 2026: 0.57 m/s after 2 s, 0.55 m/s after 12 s."""
    flight = Flight(craft)
    flight.push()
    early = flight.lean(2.0)
    late = flight.lean(10.0)
    assert early.velocity_m_s[1] == pytest.approx(-0.57, abs=0.07)
    assert late.velocity_m_s[1] == pytest.approx(-0.55, abs=0.07)
    assert speed(late) > 0.93 * speed(early)
    assert speed(flight.hover(2.0)) < 0.08


def test_it_reads_its_drag_as_level_and_leans_by_one_to_two_degrees():
    flight = Flight()
    flight.push()
    flight.lean(4.0)
    leans, said = zip(
        *((flight.true_roll_deg, flight.lean(STEP_S).angles_deg[0]) for _ in range(200)),
        strict=True,
    )
    assert 0.9 < np.mean(leans) < 2.0
    assert abs(np.mean(said)) < 0.2


def test_with_the_drag_in_its_filter_it_comes_to_rest():
    """``kalman.dragB_x`` and ``dragB_y`` of 0.31: at rest after 8 s."""
    flight = Flight(protocol=12)
    for name in ("kalman.dragB_x", "kalman.dragB_y"):
        flight.craft.set_parameter(name, 0.31)
        assert flight.craft.get_parameter(name) == 0.31
    flight.push()
    assert speed(flight.lean(2.0)) > 0.3
    assert speed(flight.lean(6.0)) < 0.1
    assert abs(flight.true_roll_deg) < 0.5


def test_the_reduced_plant_has_no_drag_and_true_angles_and_coasts_as_well():
    flight = Flight(plant="reduced")
    flight.push()
    early, late = flight.lean(2.0), flight.lean(10.0)
    assert speed(early) > 0.7
    assert speed(late) == pytest.approx(speed(early), abs=0.05)
    assert speed(flight.hover(2.0)) < 0.1


def test_its_filter_knows_velocity_and_way_within_5_percent():
    flight = Flight()
    flight.push()
    flight.lean(8.0)
    states = [flight.lean(0.06) for _ in range(33)]
    said, true = (np.mean([getattr(one, f"{name}_m_s") for one in states], axis=0)
                  for name in ("estimate", "velocity"))  # fmt: skip
    assert math.dist(said, true) < 0.05 * math.hypot(*true)
    state = states[-1]
    way = math.hypot(*state.position_m[:2])
    assert math.dist(state.estimate_m, state.position_m) < 0.05 * way
    assert state.height_m == pytest.approx(state.position_m[2], abs=0.02)


@pytest.mark.parametrize("turned", [0.0, 90.0])
def test_hover_setpoints_are_velocities_forward_and_to_the_left_of_the_heading(turned):
    flight = Flight()
    flight.up()
    flight.hover(2.0, yaw=-turned / 2.0)
    assert flight.hover(1.0).angles_deg[2] == pytest.approx(turned, abs=4.0)
    vx, vy, _ = flight.hover(3.0, ahead=0.3, left=0.15).velocity_m_s
    wanted = (0.3, 0.15) if turned == 0.0 else (-0.15, 0.3)
    assert (vx, vy) == pytest.approx(wanted, abs=0.06)


@pytest.mark.parametrize(("kind", "counter_clockwise", "protocol"), [(5, -1, 8), (10, 1, 9)])
def test_hover_setpoints_by_crtp_turn_as_their_age_says(kind, counter_clockwise, protocol):
    flight = Flight(protocol=protocol)
    talk = Conversation(flight.craft)
    packet = bytes([0x70]) + struct.pack("<Bffff", kind, 0.3, 0.0, 30.0, 0.5)
    flight.up()
    state = flight.hold(1.0, lambda: talk.answer(packet))
    assert state.angles_deg[2] * counter_clockwise > 15.0
    assert speed(state) > 0.15


def test_firmware_before_2025_does_not_know_the_newer_setpoints():
    flight = Flight(protocol=8)
    talk = Conversation(flight.craft)
    for kind in (9, 10):
        packet = bytes([0x70]) + struct.pack("<Bffff", kind, 0.0, 0.0, 0.0, 0.5)
        assert not any(flight.hold(0.5, lambda p=packet: talk.answer(p)).motors)


def test_a_stop_setpoint_stops_the_motors_at_once():
    flight = Flight()
    flight.up()
    Conversation(flight.craft).answer(b"\x70\x00")
    assert not any(flight.hold(STEP_S).motors)


@pytest.mark.parametrize("fly", [Flight.hover, Flight.lean], ids=["hover", "height"])
def test_silence_levels_it_at_its_height_after_half_a_second_and_locks_it_after_two(fly):
    flight = Flight()
    flight.up()
    fly(flight, 1.0, 0.5 if fly is Flight.hover else 8.0)
    assert flight.hold(0.44).supervisor == FLYING
    moving = flight.hold(0.16)
    assert moving.supervisor == LEVEL_OUT
    levelled = flight.hold(1.2)
    assert levelled.position_m[2] == pytest.approx(0.5, abs=0.1)
    assert speed(levelled) > 0.6 * speed(moving)
    locked = flight.hold(0.4)
    assert locked.supervisor == LOCKED
    assert not any(locked.motors)
    assert not any(flight.hover(0.5).motors)


def test_before_august_2026_the_loops_of_speed_go_on_under_other_setpoints():
    """They sum up the way that was flown, and push the craft back behind the next hover setpoint;
    since then all loops begin anew, those of height as well."""
    backwards, dips = {}, {}
    for release in ("2026.04", "2026.08"):
        flight = Flight(release=release)
        flight.push()
        flight.lean(8.0)
        backwards[release] = flight.hover(4.0).velocity_m_s[1]
        heights = [flight.lean(STEP_S).position_m[2] for _ in range(50)]
        dips[release] = 0.5 - min(heights)
    assert backwards["2026.04"] > 0.1
    assert abs(backwards["2026.08"]) < 0.03
    assert dips["2026.08"] > 0.02
    assert dips["2026.04"] < 0.02


def test_an_imu_turned_by_a_degree_moves_it_until_its_filter_has_learnt_that():
    """Hover setpoints hold it; under level ones the speed of the first moments stays."""
    flight = Flight(effects={"imu_misalignment": {"roll_deg": 1.0}})
    assert 0.05 < speed(flight.up(attitude=True)) < 0.3
    assert speed(flight.lean(10.0)) > 0.05
    assert speed(flight.hover(3.0)) < 0.05
    held = Flight(height_deck=True, flow_deck=False, effects={"imu_misalignment": {"roll_deg": 1}})
    assert math.hypot(*held.lean(10.0).position_m[:2]) > 2.0


def test_a_weak_rotor_takes_it_out_of_the_room_under_level_setpoints():
    flight = Flight(effects={"rotor_mismatch": {"rotor": 1, "excess": -0.4}})
    flight.up(attitude=True)
    state = flight.lean(15.0)
    assert math.hypot(*state.position_m[:2]) > 4.0
    assert speed(flight.hover(4.0)) < 0.1


@pytest.mark.parametrize("deck", ["flow_deck", "height_deck"])
def test_a_range_sensor_that_sticks_takes_it_to_the_ceiling(deck):
    has = {"flow_deck": False, deck: True}
    stuck = Flight(**has, range_sticks_s=READY_S + 6.0, range_stuck_m=0.3)
    assert stuck.up(attitude=True).position_m[2] == pytest.approx(0.5, abs=0.1)
    high = stuck.lean(4.0)
    assert high.position_m[2] > 5.0
    assert high.range_m == 0.3
    silent = Flight(**has, range_sticks_s=0.0)
    assert silent.lean(2.0).position_m[2] > 2.0
    assert silent.craft.state().range_m == 0.0


def test_twice_its_mass_does_not_leave_the_ground():
    flight = Flight(effects={"mass_change": {"percent": 100.0}})
    state = flight.lean(5.0)
    assert state.position_m[2] == pytest.approx(0.0, abs=0.01)
    assert state.thrust > 60000


def test_a_filter_beyond_its_bounds_begins_anew_and_says_so():
    flight = Flight()
    talk = Conversation(flight.craft)
    flight.up()
    talk.due(flight.craft.uptime_ms)
    flight.craft._firmware[0]["kalman_state"][0] = 101.0
    state = flight.hold(0.02)
    assert abs(state.estimate_m[0]) < 1.0
    assert b"ESTKALMAN: State out of bounds" in b"".join(talk.due(flight.craft.uptime_ms))


def test_on_the_floor_its_speed_runs_away_until_its_filter_is_asked_to_begin_anew():
    """A Flow deck sees nothing there: the real firmware's ran away by 3 m/s in half a minute."""
    flight = Flight(effects={"imu_misalignment": {"roll_deg": 1.0}})
    state = flight.hold(30.0)
    assert state.position_m == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert 2.0 < math.hypot(*state.estimate_m_s[:2]) < 4.0
    flight.craft.set_parameter("kalman.resetEstimation", 1.0)
    assert math.hypot(*flight.hold(0.02).estimate_m_s[:2]) < 0.05
    assert flight.craft.get_parameter("kalman.resetEstimation") == 0.0


def test_a_search_is_told_of_the_lean_that_the_filter_has():
    flown = present_effects(StandInSettings(craft="crazyflie21", flow_deck=True))
    assert flown["position_aided_lean"] == {"strength": 1.0, "time_s": 0.81}
    assert "attitude_filter_lean" not in flown
    assert flown["rotor_drag"]["drag_n_s_m"] == pytest.approx(0.31 * 0.027)


def test_the_official_library_measures_the_same():
    """Over UDP in real time, by what the craft logs of itself."""
    cflib.crtp.init_drivers()
    with (
        served(craft="crazyflie21plus", flow_deck=True, release="2026.08", seed=4) as craft,
        SyncCrazyflie(craft.uri, cf=Crazyflie()) as connected,
    ):
        log, said = LogConfig("place", 20), {}
        for name in ("stateEstimate.y", "stateEstimate.vy", "stateEstimate.z"):
            log.add_variable(name, "float")
        log.data_received_cb.add_callback(lambda _, data, __: said.update(data))
        connected.cf.log.add_config(log)
        log.start()
        commander = connected.cf.commander

        def hold(seconds, send):
            end = craft.craft.time_s + seconds
            while craft.craft.time_s < end:
                send()
                time.sleep(STEP_S)
            return said["stateEstimate.vy"]

        hold(5.0, lambda: commander.send_hover_setpoint(0.0, 0.0, 0.0, 0.5))
        assert said["stateEstimate.z"] == pytest.approx(0.5, abs=0.06)
        hold(0.6, lambda: commander.send_zdistance_setpoint(8.0, 0.0, 0.0, 0.5))
        early = hold(2.0, lambda: commander.send_zdistance_setpoint(0.0, 0.0, 0.0, 0.5))
        late = hold(10.0, lambda: commander.send_zdistance_setpoint(0.0, 0.0, 0.0, 0.5))
        assert early == pytest.approx(-0.57, abs=0.12)
        assert late == pytest.approx(early, abs=0.08)
        stopped = hold(2.0, lambda: commander.send_hover_setpoint(0.0, 0.0, 0.0, 0.5))
        assert stopped == pytest.approx(0.0, abs=0.1)
        commander.send_stop_setpoint()
        until(lambda: not any(craft.craft.state().motors), "the motors stand")
