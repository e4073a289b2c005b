"""One rule for every stage: which rows of a run are in the air."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.identification.flight import CONTACT_S, TAKE_OFF_S, airborne, flights_in
from groundstation.identification.runs import CHANNELS, Run
from groundstation.telemetry.packet import STANDARD_GRAVITY

T = 0.002
START, STOP, ROWS = 1000, 6000, 7000
CLIMB_ROWS = 250


@pytest.fixture(scope="module")
def run():
    """Rest, a climb that begins half a second after the motors, ten seconds in all, rest."""
    duty, force = np.zeros((ROWS, 4)), np.zeros((ROWS, 3))
    duty[START:STOP] = 0.6
    force[:, 2] = STANDARD_GRAVITY
    lift = START + CLIMB_ROWS
    force[lift : lift + CLIMB_ROWS, 2] += 1.0
    force[lift + CLIMB_ROWS : lift + 2 * CLIMB_ROWS, 2] -= 1.0
    sink = STOP - 3 * CLIMB_ROWS
    force[sink : sink + CLIMB_ROWS, 2] -= 1.0
    force[sink + CLIMB_ROWS : sink + 2 * CLIMB_ROWS, 2] += 1.0
    nothing = np.full((ROWS, 4), np.nan)
    level = np.zeros((ROWS, 3))
    full, still = np.full(ROWS, 3.9), level[:, 0]
    return Run("hop", 0.0, T, duty, full, level, force, level, nothing, still, nothing)


def test_the_ground_carries_until_the_craft_is_two_centimetres_up(run):
    (flight,) = flights_in(run)
    assert (flight.start, flight.stop, flight.rests) == (START, STOP, (True, True))
    lift, sink = START + CLIMB_ROWS, STOP - CLIMB_ROWS
    assert lift < flight.first < lift + 0.25 / T
    assert sink - 0.4 / T < flight.last < sink
    assert flight.height_m[flight.first] == pytest.approx(0.02, abs=0.002)


def _longer(values, before, after):
    return np.pad(values, [(before, after)] + [(0, 0)] * (values.ndim - 1), "edge")


def test_motors_that_idle_on_the_ground_make_no_flight_longer(run):
    """An armed Brushless idles at 7000 of 65535, which a row can also have in flight."""
    before, after = 5000, 2000
    padded = {name: _longer(getattr(run, name), before, after) for name in CHANNELS}
    padded["duty"][1000 : before + START] = 7000.0 / 65535.0
    padded["duty"][before + STOP : -500] = 7000.0 / 65535.0
    (still,), (idling,) = flights_in(run), flights_in(replace(run, **padded))
    assert (idling.first - before, idling.last - before) == (still.first, still.last)
    assert idling.rests == still.rests
    height = idling.height_m[before + still.first : before + still.last]
    np.testing.assert_allclose(height, still.height_m[still.first : still.last], atol=1e-9)


@pytest.mark.parametrize("idle_rows", [50, 400])
def test_motors_that_idle_on_for_a_moment_after_the_landing_carry_no_flight_on(run, idle_rows):
    """The recording ends before the craft has lain still for as long as a rest lasts."""
    duty = run.duty.copy()
    duty[STOP : STOP + idle_rows] = 7000.0 / 65535.0
    (still,), (idling,) = flights_in(run), flights_in(replace(run, duty=duty)[: STOP + idle_rows])
    assert still.last <= idling.last <= STOP
    ending = replace(run, duty=duty)[: STOP + max(idle_rows, 350)]
    assert flights_in(ending)[0].last == still.last


@pytest.mark.parametrize("rows_after_the_stop", [0, 100])
def test_a_craft_that_strikes_the_ground_is_down_though_its_motors_turn_on(
    run, rows_after_the_stop
):
    """NanoBench's recordings break off there, after shocks of up to 7 g under turning motors."""
    hit = STOP - 200
    force = run.accelerometer.copy()
    force[hit : hit + 3, 2] += 4.0 * STANDARD_GRAVITY
    cut = replace(run, accelerometer=force)[: STOP + rows_after_the_stop]
    (flight,) = flights_in(cut)
    assert flight.stop == STOP
    assert hit - 0.03 / T < flight.last < hit


def test_rotors_that_shake_the_accelerometer_end_no_flight(run):
    """Unfiltered, it shows 1 g and more of them in every row."""
    force = run.accelerometer.copy()
    force[START:STOP, 2] += 1.2 * STANDARD_GRAVITY * (-1.0) ** np.arange(STOP - START)
    (still,), (shaken,) = flights_in(run), flights_in(replace(run, accelerometer=force))
    assert shaken.last == pytest.approx(still.last, abs=0.1 / T)


def test_without_an_accelerometer_time_decides(run):
    (flight,) = flights_in(replace(run, accelerometer=np.full((ROWS, 3), np.nan)))
    assert flight.first == START + round(TAKE_OFF_S / T)
    assert flight.last == STOP - round(CONTACT_S / T)


def test_a_recording_that_begins_and_ends_in_the_air_is_all_flight_but_for_its_start(run):
    mask = airborne(run[START + 1500 : STOP - 1500])
    assert mask[250:].all()
    assert not mask[:250].any()


def test_a_dead_rotor_sensor_grounds_no_craft(run):
    dead = replace(run, rotor_rev_s=np.zeros((ROWS, 4)))
    np.testing.assert_array_equal(airborne(dead), airborne(run))


def test_where_pwm_was_not_recorded_the_rotors_tell_when_they_turn(run):
    speed = np.where(run.duty > 0.0, 300.0, 0.0)
    unpowered = replace(run, duty=np.full((ROWS, 4), np.nan), rotor_rev_s=speed)
    np.testing.assert_array_equal(airborne(unpowered), airborne(run))


def test_motors_that_never_lift_the_craft_make_no_flight(run):
    idle = replace(run, accelerometer=np.tile([0.0, 0.0, STANDARD_GRAVITY], (ROWS, 1)))
    assert not airborne(idle).any()
