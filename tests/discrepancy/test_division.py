"""What is held out leaves the fit what it needs, and has it too."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.discrepancy.engine import divide, usable
from groundstation.errors import BadInputError
from groundstation.identification.runs import CHANNELS, Run
from support import flights

PERIOD_S = 0.01
SECONDS = 60.0


def flown(yaw_s=(0.0, SECONDS), seed=0):
    """A recording of a craft that steers about every axis, about yaw only within ``yaw_s``."""
    rows = round(SECONDS / PERIOD_S)
    time = PERIOD_S * np.arange(rows)
    draw = np.random.default_rng(seed)
    roll, pitch, yaw, thrust = 0.02 * draw.normal(size=(4, rows))
    yaw[(time < yaw_s[0]) | (time >= yaw_s[1])] = 0.0
    duty = 0.6 + np.column_stack(
        [thrust - pitch - yaw, thrust - roll + yaw, thrust + pitch - yaw, thrust + roll + yaw]
    )
    columns = {name: np.zeros((rows, 3)) for name in CHANNELS}
    columns |= {"duty": duty, "rotor_rev_s": np.full((rows, 4), np.nan)}
    columns |= {"supply_v": np.full(rows, 3.9), "debug_s": np.zeros(rows)}
    columns["duty_step"] = np.full((rows, 4), np.nan)
    return [Run("flight", 0.0, PERIOD_S, **columns)]


def spans(runs):
    return [(run.start_s, run.start_s + run.seconds) for run in runs]


def held_out(parts):
    return [one.run[one.first : one.last] for one in parts.judged]


def test_the_last_third_is_held_out_where_it_serves():
    parts = divide([flown()], [], "plus")
    assert parts.what == "last third"
    assert spans(parts.fit_on) == [(0.0, pytest.approx(40.0))]
    assert spans(held_out(parts)) == [(pytest.approx(40.0), pytest.approx(60.0))]
    (judged,) = parts.judged
    assert (judged.first, judged.last, len(judged.run)) == (4000, 6000, 6000)


@pytest.mark.parametrize(
    ("yaw_s", "held"), [((12.0, 40.0), "first third"), ((37.0, 60.0), "middle third")]
)
def test_another_third_is_where_the_last_one_has_or_leaves_no_yaw(yaw_s, held):
    parts = divide([flown(yaw_s)], [], "plus")
    assert parts.what == held
    assert sum(run.seconds for run in parts.fit_on) == pytest.approx(40.0)
    assert sum(run.seconds for run in held_out(parts)) == pytest.approx(20.0)


def test_lost_rows_and_recordings_in_pieces_are_divided_alike():
    (whole,) = flown(seed=1)
    duty = whole.duty.copy()
    duty[::7] = np.nan
    lossy = replace(whole, duty=duty)
    parts = divide([[lossy[:2500], lossy[2500:]]], [], "plus")
    assert parts.what == "last third"
    assert [len(run) for run in parts.fit_on] == [2500, 1500]
    assert [(one.first, one.last) for one in parts.judged] == [(1500, 3500)]


def test_given_recordings_are_held_out_as_they_are():
    parts = divide([flown()], [flown(seed=2)], "plus")
    assert parts.what == ""
    assert [len(run) for run in held_out(parts)] == [6000]
    assert [len(run) for run in parts.fit_on] == [6000]


def test_thirds_are_those_of_the_rows_in_the_air():
    (run,) = flown(seed=3)
    duty = run.duty.copy()
    duty[:1500], duty[3000:] = 0.0, 0.0
    parts = divide([[replace(run, duty=duty)]], [], "plus")
    assert spans(parts.fit_on) == [(0.0, pytest.approx(25.0))]
    assert spans(held_out(parts)) == [(pytest.approx(25.0), pytest.approx(60.0))]


def cut_to(seconds, seed, name, steering=1.0):
    (run,) = flown(seed=seed)
    duty = 0.6 + steering * (run.duty - 0.6)
    return replace(run, name=name, duty=duty)[: round(seconds / PERIOD_S)]


def test_of_short_flights_a_whole_one_is_held_out():
    short = [cut_to(8.0, 4, "calm", 0.1), cut_to(8.0, 5, "one"), cut_to(8.0, 6, "two")]
    parts = divide([[run] for run in short], [], "plus")
    (held,) = held_out(parts)
    assert held.name in ("one", "two")
    assert parts.what == f"all of {held.name}"
    assert sorted(run.name for run in (*parts.fit_on, held)) == ["calm", "one", "two"]
    assert [(one.first, one.last) for one in parts.judged] == [(0, 800)]


def test_beside_a_long_flight_a_short_one_is_fitted_whole():
    long, short = cut_to(30.0, 7, "long"), cut_to(8.0, 8, "short")
    parts = divide([[short], [long]], [], "plus")
    assert [run.name for run in held_out(parts)] == ["long"]
    assert parts.what == "last third of those of 14 s and more"
    assert [(run.name, len(run)) for run in parts.fit_on] == [("short", 800), ("long", 2000)]


def test_one_short_flight_is_not_enough():
    with pytest.raises(BadInputError, match=r"of 8\.0 s in the air none can be held out"):
        divide([[cut_to(8.0, 9, "short")]], [], "plus")


def on_ground(seconds, name="ground"):
    run = cut_to(seconds, 10, name)
    return replace(run, duty=np.zeros_like(run.duty))


def test_a_recording_on_the_ground_is_no_flight_that_could_be_held_out():
    short = [cut_to(8.0, 11, "one"), cut_to(8.0, 12, "two")]
    parts = divide([[on_ground(20.0)], *([run] for run in short)], [], "plus")
    (held,) = held_out(parts)
    assert held.name in ("one", "two")
    nothing = divide([[on_ground(20.0)]], [], "plus")  # and then who asks for a flight refuses
    assert len(nothing.judged) == len(nothing.fit_on) == 1


def test_a_rest_between_two_short_flights_makes_no_long_one():
    run = cut_to(30.0, 13, "twice")
    duty = run.duty.copy()
    duty[300:2700] = 0.0
    with pytest.raises(BadInputError, match=r"of 6\.0 s in the air"):
        divide([[replace(run, duty=duty)]], [], "plus")


def test_recordings_of_two_rates_are_each_judged_by_their_own():
    fast = replace(cut_to(40.0, 14, "fast"), period_s=0.2 * PERIOD_S)  # 8 s
    slow = cut_to(20.0, 15, "slow")
    for order in ([[fast], [slow]], [[slow], [fast]]):
        parts = divide(order, [], "plus")
        assert [run.name for run in held_out(parts)] == ["slow"]
        assert parts.what == "last third of those of 14 s and more"


def test_of_one_flight_that_is_no_three_pieces_long_the_last_seconds_are_held_out():
    run = cut_to(12.0, 16, "alone")
    duty = run.duty.copy()
    duty[:100], duty[1100:] = 0.0, 0.0
    parts = divide([[replace(run, duty=duty)]], [], "plus")
    assert parts.what == "last 4.5 s"
    assert spans(parts.fit_on) == [(0.0, pytest.approx(6.5))]
    assert spans(held_out(parts)) == [(pytest.approx(6.5), pytest.approx(12.0))]
    longer = divide([[cut_to(12.0, 16, "alone")]], [], "plus")
    assert longer.what == "last 5.4 s"
    assert spans(held_out(longer)) == [(pytest.approx(6.6), pytest.approx(12.0))]


# What a search leaves out of recordings, and says so.


@pytest.fixture(scope="module")
def flight():
    return flights.flown(10.0, 3)[0]


def at_full_duty(run, share):
    duty = run.duty.copy()
    duty[: round(share * len(run)), 3] = 1.0
    return replace(run, name="full", duty=duty)


def test_a_flight_whose_motor_is_mostly_saturated_is_left_out_where_another_is_left(flight):
    groups = [[flight], [at_full_duty(flight, 0.6)]], [[flight]]
    (fitted, held), warnings = usable(groups, flights.BASE)
    assert [[run.name for run in part] for part in fitted] == [[flight.name]]
    assert len(held) == 1
    assert warnings == ["full: left out, a motor is saturated in most rows"]


def test_one_that_is_saturated_less_often_stays(flight):
    (fitted, _), warnings = usable(([[at_full_duty(flight, 0.4)], [flight]], []), flights.BASE)
    assert len(fitted) == 2
    assert not warnings


def test_where_none_else_is_left_it_stays_to_be_refused(flight):
    (fitted, _), warnings = usable(([[at_full_duty(flight, 0.6)]], [[flight]]), flights.BASE)
    assert len(fitted) == 1
    assert not warnings


def test_a_flight_without_a_channel_that_is_needed_is_left_out_where_another_has_it(flight):
    silent = replace(flight, name="silent", duty=np.full_like(flight.duty, np.nan))
    (fitted, held), warnings = usable(([[silent], [flight]], [[flight]]), flights.BASE)
    assert fitted == held == [[flight]]
    assert warnings == ["silent: left out, the motors' PWM is not in the recording"]


def test_where_no_flight_has_it_that_is_refused(flight):
    silent = replace(flight, name="silent", gyro=np.full_like(flight.gyro, np.nan))
    with pytest.raises(BadInputError, match="silent: the gyro is not in the recording"):
        usable(([[flight]], [[silent]]), flights.BASE)


def test_a_dead_rotor_sensor_is_left_out_by_name(flight):
    speeds = np.full_like(flight.rotor_rev_s, 250.0) * (1.0 + 0.1 * flight.duty)
    speeds[:, 1] = 3.0
    (((run,),), _), warnings = usable(([[replace(flight, rotor_rev_s=speeds)]], []), flights.BASE)
    assert np.isnan(run.rotor_rev_s).all()
    assert len(warnings) == 1


def test_of_a_recording_in_two_runs_one_may_be_left_out_by_its_seconds(flight):
    full = replace(at_full_duty(flight, 0.6), name=flight.name, start_s=flight.start_s + 20.0)
    (fitted, _), warnings = usable(([[flight, full]], []), flights.BASE)
    assert fitted == [[flight]]
    assert warnings == [
        f"{flight.name}, 20 to {20 + flight.seconds:.0f} s: left out, a motor is saturated in most"
        " rows"
    ]
