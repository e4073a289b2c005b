"""What a search leaves out of recordings, and says so."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.discrepancy.engine import usable
from groundstation.errors import BadInputError
from support.flights import BASE, flown


@pytest.fixture(scope="module")
def flight():
    return flown(10.0, 3)[0]


def at_full_duty(run, share):
    duty = run.duty.copy()
    duty[: round(share * len(run)), 3] = 1.0
    return replace(run, name="full", duty=duty)


def test_a_flight_whose_motor_is_mostly_saturated_is_left_out_where_another_is_left(flight):
    groups = [[flight], [at_full_duty(flight, 0.6)]], [[flight]]
    (fitted, held), warnings = usable(groups, BASE)
    assert [[run.name for run in part] for part in fitted] == [[flight.name]]
    assert len(held) == 1
    assert warnings == ["full: left out, a motor is saturated in most rows"]


def test_one_that_is_saturated_less_often_stays(flight):
    (fitted, _), warnings = usable(([[at_full_duty(flight, 0.4)], [flight]], []), BASE)
    assert len(fitted) == 2
    assert not warnings


def test_where_none_else_is_left_it_stays_to_be_refused(flight):
    (fitted, _), warnings = usable(([[at_full_duty(flight, 0.6)]], [[flight]]), BASE)
    assert len(fitted) == 1
    assert not warnings


def test_a_flight_without_a_channel_that_is_needed_is_left_out_where_another_has_it(flight):
    silent = replace(flight, name="silent", duty=np.full_like(flight.duty, np.nan))
    (fitted, held), warnings = usable(([[silent], [flight]], [[flight]]), BASE)
    assert fitted == held == [[flight]]
    assert warnings == ["silent: left out, the motors' PWM is not in the recording"]


def test_where_no_flight_has_it_that_is_refused(flight):
    silent = replace(flight, name="silent", gyro=np.full_like(flight.gyro, np.nan))
    with pytest.raises(BadInputError, match="silent: the gyro is not in the recording"):
        usable(([[flight]], [[silent]]), BASE)


def test_a_dead_rotor_sensor_is_left_out_by_name(flight):
    speeds = np.full_like(flight.rotor_rev_s, 250.0) * (1.0 + 0.1 * flight.duty)
    speeds[:, 1] = 3.0
    (((run,),), _), warnings = usable(([[replace(flight, rotor_rev_s=speeds)]], []), BASE)
    assert np.isnan(run.rotor_rev_s).all()
    assert len(warnings) == 1


def test_of_a_recording_in_two_runs_one_may_be_left_out_by_its_seconds(flight):
    full = replace(at_full_duty(flight, 0.6), name=flight.name, start_s=flight.start_s + 20.0)
    (fitted, _), warnings = usable(([[flight, full]], []), BASE)
    assert fitted == [[flight]]
    assert warnings == [
        f"{flight.name}, 20 to {20 + flight.seconds:.0f} s: left out, a motor is saturated in most"
        " rows"
    ]
