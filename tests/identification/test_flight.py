"""Which rows are in the air, which channels are means of two readings, how noisy speeds are."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from groundstation.identification.flight import (
    CONTACT_S,
    TAKE_OFF_S,
    airborne,
    angles_read_between,
    flights_in,
    force_read_between,
    half_a_row_later,
    mean_between,
    prepare,
    speed_spectrum,
)
from groundstation.identification.runs import CHANNELS, Run, flights_of
from groundstation.telemetry.packet import STANDARD_GRAVITY
from support.flights import recorded, truth_of

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


def test_a_dead_rotor_sensor_grounds_no_craft_and_rotors_tell_where_pwm_was_not_recorded(run):
    speed = np.where(run.duty > 0.0, 300.0, 0.0)
    dead = replace(run, rotor_rev_s=0.0 * speed)
    unpowered = replace(run, duty=np.full((ROWS, 4), np.nan), rotor_rev_s=speed)
    for one in (dead, unpowered):
        np.testing.assert_array_equal(airborne(one), airborne(run))


def test_motors_that_never_lift_the_craft_make_no_flight(run):
    idle = replace(run, accelerometer=np.tile([0.0, 0.0, STANDARD_GRAVITY], (ROWS, 1)))
    assert not airborne(idle).any()


ROWS_HZ = 250.0
COUNT = 20_000


@pytest.fixture(scope="module")
def motion():
    """(2 n, 3): what is there, twice a row, behind the firmware's low-pass of 80 Hz."""
    draw = np.random.default_rng(3).standard_normal((2 * COUNT, 3))
    return lfilter(*butter(2, 80.0, fs=2.0 * ROWS_HZ), draw, axis=0)


def readings(values, seed=4, noise=0.1):
    """The same with noise that each reading has anew."""
    return values + noise * np.random.default_rng(seed).standard_normal(values.shape)


def at_rows(values):
    return values[2::2]


def between(values):
    """At the same rows, from the readings half a row before and half a row after."""
    return 0.5 * (values[1:-1:2] + values[3::2])


def test_a_model_is_averaged_as_readings_between_rows_are(motion):
    modelled = mean_between(at_rows(motion))
    wrong, plain = (between(motion) - one for one in (modelled, at_rows(motion)))
    assert np.std(wrong) < 0.5 * np.std(plain)


def test_between_two_rows_a_smooth_motion_is_known():
    turns = 20.0 / ROWS_HZ * np.linspace(np.arange(200), np.arange(200) + 0.6, 3, axis=1)
    later = np.sin(2.0 * np.pi * (turns + 10.0 / ROWS_HZ))
    assert half_a_row_later(np.sin(2.0 * np.pi * turns))[2:-2] == pytest.approx(
        later[2:-2], abs=0.01
    )


def test_forces_read_between_rows_are_seen_to_be(motion):
    assert force_read_between(between(readings(motion)))
    assert not force_read_between(at_rows(readings(motion)))


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_angles_read_between_rows_are_seen_to_be_with_noise_of_their_own_and_without(motion, noise):
    angles = readings(np.cumsum(motion, axis=0), noise=noise)
    gyro = at_rows(motion)[1:]
    assert angles_read_between(np.diff(between(angles), axis=0), gyro)
    assert not angles_read_between(np.diff(at_rows(angles), axis=0), gyro)


@pytest.mark.filterwarnings("error")
def test_a_channel_that_never_changes_and_few_rows_tell_nothing(motion):
    assert not force_read_between(np.ones((COUNT, 3)))
    few = at_rows(motion)[:100]  # no warning of scipy
    assert not angles_read_between(few, few)


def flight_with(noise_rev_s, rows_apart=1, held_rows=1):
    """A flight whose true speeds are recorded, with white noise, every few rows, or held."""
    samples, truth = recorded(30.0, plant="reduced", seed=31)
    speeds = truth_of(samples, truth)["rotor_rev_s"].astype(np.float64)[::rows_apart]
    samples = samples[::rows_apart]
    speeds += np.random.default_rng(31).normal(0.0, noise_rev_s, speeds.shape)
    samples.rotor_rev_s[:] = speeds[held_rows * (np.arange(len(speeds)) // held_rows)]
    return prepare(flights_of(samples, "flight"))[0]


# half of a held reading's power is left at half its rate, and it has twice as much at first
@pytest.mark.parametrize(("held_rows", "share"), [(1, 1.0), (2, 1.3)])
def test_the_noise_is_that_of_the_sensor(held_rows, share):
    seen = speed_spectrum(flight_with(0.5, held_rows=held_rows))
    rows = 2 * (len(seen.hz) - 1)
    # of four rotors, beside the mean square of a Hann window
    assert seen.noise == pytest.approx(share * 4.0 * 0.5**2 * rows * 0.375, rel=0.15)


def test_readings_too_rare_do_not_tell_noise_from_motion():
    assert speed_spectrum(flight_with(0.5, rows_apart=5)).noise is None
