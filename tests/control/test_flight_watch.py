"""What makes a craft that holds its height land."""

import dataclasses
import math

import pytest

from groundstation.control.programme import BLIND, NO_LIFT, FlightWatch, Seen
from support.flights import HOVERS


def seen(time_s, **changes):
    return dataclasses.replace(HOVERS, **{"time_s": time_s, "place_s": time_s} | changes)


def watch(home=(0.0, 0.0), reach_m=1.0):
    found = FlightWatch(home, 0.0, reach_m, begun_s=-10.0)
    found.hover_thrust = 4.0
    return found


def first(watching, seconds, asked_m=0.5, **how):
    """When it gives its first reason, s, and which; how: functions of time."""
    for tick in range(round(100 * seconds)):
        time_s = 0.01 * tick
        now = seen(time_s, **{name: value(time_s) for name, value in how.items()})
        reason = watching.reason(now, asked_m)
        if reason:
            return time_s, reason
    return seconds, ""


def test_a_craft_that_hovers_in_its_place_flies_on():
    assert first(watch(), 20.0) == (20.0, "")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"x_m": 1.2, "y_m": 0.9}, ""),
        ({"x_m": 1.2, "y_m": 1.0}, "position: 1.6 m from take-off, the limit is 1.5 m"),
        ({"x_m": math.nan}, "position"),
        ({"vx_m_s": -1.6}, "speed: 1.6 m/s, the limit is 1.5 m/s"),
        ({"age_s": 1.1}, "no position from the craft for 1 s"),
        ({"age_s": math.inf}, "no position"),
    ],
)
def test_it_must_stay_in_its_room_and_below_its_speed_and_say_so(changes, reason):
    assert watch().reason(seen(0.0, **changes), 0.5).startswith(reason)
    assert bool(watch().reason(seen(0.0, **changes), 0.5)) == bool(reason)


def test_a_craft_that_does_not_know_its_place_is_watched_for_its_height_alone():
    lost = dict.fromkeys(("x_m", "y_m", "vx_m_s", "vy_m_s", "climb_m_s"), math.nan)
    assert watch(home=None).reason(seen(0.0, **lost, age_s=math.inf), 0.5) == ""
    assert first(watch(home=None), 3.0, height_m=lambda t: 0.9)[1].startswith("height")


def test_a_height_that_is_not_what_was_asked_for_is_borne_for_a_second():
    when, reason = first(watch(), 5.0, height_m=lambda t: 0.81)
    assert when == pytest.approx(1.0)
    assert reason == "height: 0.81 m high for 1 s, 0.50 m was requested"
    # a step is made within a second
    step = first(watch(), 5.0, height_m=lambda t: 0.9 if t % 2.0 < 0.9 else 0.5)
    assert not step[1].startswith("height:")
    unknown = first(watch(), 5.0, height_m=lambda t: 0.5 if t < 1.0 else math.nan)
    assert unknown[1].startswith("height: nan m high for 1 s")


def test_a_height_sensor_that_sticks_contradicts_the_climb_rate():
    """As a craft climbs away on it, and at the first take-off where it always says 0."""
    when, reason = first(watch(), 5.0, climb_m_s=lambda t: 0.3)
    assert when == pytest.approx(0.5, abs=0.02)
    assert reason.startswith(BLIND)
    jumps = first(watch(), 5.0, height_m=lambda t: 0.5 if t < 1.0 else 0.3)
    assert jumps[0] == pytest.approx(1.0)
    climbs = first(watch(), 2.0, height_m=lambda t: 0.5 + 0.1 * t, climb_m_s=lambda t: 0.1)
    assert climbs[1] == ""


def test_what_a_gap_in_the_telemetry_hides_is_no_contradiction():
    watching = watch()
    assert watching.reason(seen(0.0), 0.5) == ""
    assert watching.reason(seen(0.6, height_m=0.7, climb_m_s=0.2), 0.5) == ""


@pytest.mark.parametrize("every_s", [0.04, 0.2, 0.3, 0.4])
def test_a_sensor_that_sticks_is_told_from_places_that_come_seldom(every_s):
    def at_times(t):
        return every_s * (t // every_s + 1e-9)

    when, reason = first(
        watch(), 6.0, place_s=at_times, climb_m_s=lambda t: 0.6 if at_times(t) > 2.0 else 0.0
    )
    assert reason.startswith(BLIND)
    assert 2.0 < when < 3.0


def test_a_craft_whose_places_come_too_seldom_to_check_its_height_is_landed():
    when, reason = first(watch(), 6.0, place_s=lambda t: 0.6 * (t // 0.6))
    assert when == pytest.approx(3.0, abs=0.1)
    assert reason == "height: 0.50 m high, and for 3 s its places came too seldom to check it"


def test_a_place_that_comes_later_than_the_rest_is_no_contradiction():
    """As a host that is held up hears of it: it stands for 0.3 s while the craft climbs."""
    watching = watch()
    for tick in range(200):
        time_s = 0.01 * tick
        place_s = time_s if time_s < 0.5 else max(0.5, time_s - 0.3)
        height = 0.3 + 0.6 * place_s
        now = seen(time_s, height_m=height, climb_m_s=0.6, place_s=place_s)
        assert not watching.reason(now, height).startswith(BLIND)


def test_thrust_far_above_hover_is_borne_for_half_a_second():
    assert first(watch(), 5.0, thrust=lambda t: 5.9)[1] == ""
    when, reason = first(watch(), 5.0, thrust=lambda t: 6.2)
    assert when == pytest.approx(0.5)
    assert reason == "thrust: 1.6 times that of hover, the limit is 1.5 times"
    assert first(watch(), 5.0, thrust=lambda t: 9.0 if t % 1.0 < 0.4 else 4.0)[1] == ""


def test_a_craft_that_stays_on_the_ground_has_not_taken_off():
    def taking_off():
        return FlightWatch((0.0, 0.0), 0.02, 1.0, begun_s=0.0)

    when, reason = first(taking_off(), 5.0, height_m=lambda t: 0.05)
    assert when == pytest.approx(2.0)
    assert reason == f"{NO_LIFT}: 0.05 m high 2 s after the start"
    late = first(taking_off(), 5.0, height_m=lambda t: min(0.3 * max(t - 1.0, 0.0), 0.5),
                 climb_m_s=lambda t: 0.3 if 1.0 < t < 2.7 else 0.0)  # fmt: skip
    assert late[1] == ""


def test_what_the_daemon_answers_is_read_in_the_signs_of_the_telemetry():
    answer = {
        "height_m": 0.4,
        "place": {"x_m": 1.0, "y_m": -2.0, "z_m": 0.5, "vx_m_s": 0.3, "vy_m_s": -0.4,
                  "vz_m_s": 0.1, "age_s": 0.02},
        "telemetry": {"timestamp": 986301, "roll_deg": 1.0, "pitch_deg": 2.0, "yaw_deg": 90.0,
                      "battery_v": 4.0, "motors": [0.5, 0.5, 0.7, 0.7]},
    }  # fmt: skip
    now = Seen.of(answer)
    assert now.time_s == pytest.approx(1.0, rel=1e-6)
    assert (now.height_m, now.climb_m_s) == (0.5, 0.1)
    assert now.speed_m_s == pytest.approx(0.5)
    assert now.away_m((1.0, -1.0)) == pytest.approx(1.0)
    assert now.away_m((1.0, -1.0), ahead_s=1.0) == pytest.approx(math.hypot(0.3, 1.4))
    assert now.heading_rad == pytest.approx(math.pi / 2)
    assert now.thrust == pytest.approx(16.0 * (0.25 + 0.49) / 2.0)
    placeless = Seen.of({**answer, "place": None})
    assert placeless.height_m == 0.4
    assert math.isnan(placeless.x_m)
