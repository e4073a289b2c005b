"""One judgement of samples: what inspect tells is what every later step takes as missing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.recording.quality import inspect_recording, rejected, rejections, sound
from groundstation.recording.session import Recording
from support.flights import recorded, truth_of

SECOND = 500
"""Rows."""


@pytest.fixture(scope="module")
def flight():
    """20 s from rest on the ground into the air, with rotor speeds."""
    samples, truth = recorded(20.0, plant="faithful", seed=31)
    speeds = truth_of(samples, truth)["rotor_rev_s"].astype(np.float32)
    return replace(samples, rotor_rev_s=speeds, copies=np.ones(len(samples), np.uint8))


def judged(samples):
    """What is left of samples, what is said of them, and what inspect says."""
    whole = Recording(Path("made.csv"), "csv", samples)
    left = sound(whole)
    return left.samples, rejected(left), inspect_recording(whole)["verdict"]


def changed(samples, name, change):
    values = getattr(samples, name).copy()
    change(values)
    return replace(samples, **{name: values})


def missing(samples, name):
    """Rows in which a field does not read."""
    values = getattr(samples, name)
    return ~np.isfinite(values if values.ndim == 1 else values.sum(axis=1))


def test_a_sound_recording_stays_as_it_is(flight):
    whole = Recording(Path("made.csv"), "csv", flight)
    assert sound(whole) is whole
    assert rejected(whole) == []


def extrapolated(duty):
    """Motors of which two leave their range later than the others."""
    slopes = np.array([-0.4, -0.2, 0.02, 0.0])
    after = np.arange(1, 10 * SECOND + 1)[:, None] / SECOND
    rows = len(duty) - 10 * SECOND
    duty[rows:] = duty[rows - 1] + slopes * after[: len(duty) - rows]


def test_what_was_extrapolated_beyond_its_range_is_missing_from_where_that_began(flight):
    left, said, verdict = judged(changed(flight, "duty", extrapolated))
    lost = missing(left, "duty")
    began = len(flight) - 10 * SECOND
    assert lost[began + 5 :].all()
    assert not lost[: began - 5].any()
    assert len(said) == 1
    assert said[0].startswith("made.csv: taken as missing: duty_1, duty_2 up to -")
    assert "from 10.0 s on" in said[0]
    assert said[0].removeprefix("made.csv: taken as missing: ") in verdict


def test_what_is_nonsense_from_some_moment_on_is_missing_from_there(flight):
    def noise(duty):
        duty[5000:] = np.random.default_rng(1).normal(-2.0, 1.5, (len(duty) - 5000, 4))

    left, said, _ = judged(changed(flight, "duty", noise))
    assert np.flatnonzero(missing(left, "duty"))[0] in range(5000, 5020)
    assert missing(left, "duty")[5020:].all()
    assert len(said) == 1


def test_a_stretch_that_was_extrapolated_in_between_is_missing_and_the_rest_is_not(flight):
    def arc(duty):
        after = np.linspace(0.0, 1.0, 1000)[:, None]
        duty[6000:7000] = duty[5999] - 8.0 * after * (1.0 - after)

    left, _, _ = judged(changed(flight, "duty", arc))
    lost = np.flatnonzero(missing(left, "duty"))
    assert lost[0] in range(5995, 6005)
    assert lost[-1] in range(6995, 7005)
    assert len(lost) > 980


@pytest.mark.parametrize(
    ("name", "scale"), [("battery_v", 1000.0), ("gyro", 573.0), ("accelerometer", 98.1)]
)
def test_a_field_in_another_unit_is_missing_as_a_whole(flight, name, scale):
    left, said, _ = judged(changed(flight, name, lambda values: np.multiply(values, scale, values)))
    assert missing(left, name).all()
    assert "check unit and scale" in said[0]


def put(rows, value, *column):
    """What sets rows of a field, or of one of its columns."""
    return lambda values: values.__setitem__((rows, *column), value)


def keep(first, last):
    """What repeats a row until another."""
    return lambda values: values.__setitem__(slice(first, last), values[first].copy())


def swing(values):
    """Rates of 30 deg/s at 1 Hz, from 8 s on: it lies on the ground before."""
    values[8 * SECOND :] += (
        np.radians(30.0) * np.sin(2 * np.pi * np.arange(8 * SECOND, len(values)) / SECOND)[:, None]
    )


THIRD, SPIKES, SOME, BLOCK = np.s_[::3], np.s_[3000:9000:500], np.s_[700::400], slice(3000, 6000)
FROZEN = "is frozen for 2000 samples from number 5001 on"
NO_VALUE = "far from all others: it stands for no value"


@pytest.mark.parametrize(
    ("field", "change", "rows", "words"),
    [
        ("gyro", put(SPIKES, 90.0, 2), SPIKES, "in 12 of 9990 samples"),
        ("duty", put(np.s_[4000:4100:2], 1.2, 1), np.s_[4000:4100:2], "full duty in 50 samples"),
        ("gyro", keep(5000, 7000), slice(5001, 7000), f"the gyro {FROZEN}"),
        ("accelerometer", keep(5000, 7000), slice(5001, 7000), f"the accelerometer {FROZEN}"),
        ("attitude", keep(5000, 7000), slice(5001, 7000), "attitude stands for 4.0 s while the"),
        ("gyro", put(SOME, np.radians(-999.0), 1), SOME, "in 24 of 9990 samples"),
        ("accelerometer", put(SOME, 1e30, 1), SOME, "in 24 of 9990 samples"),
        ("attitude", put(SOME, np.radians(-9999.0), 1), SOME, "in 24 of 9990 samples"),
        ("gyro", put(BLOCK, np.radians(-999.0), 1), BLOCK, NO_VALUE),
        ("accelerometer", put(BLOCK, 1e30, 1), BLOCK, NO_VALUE),
        ("attitude", put(BLOCK, np.radians(-9999.0), 1), BLOCK, NO_VALUE),
        ("duty", put(BLOCK, -1.0 / 65535.0, 1), BLOCK, NO_VALUE),
        ("duty", put(BLOCK, -1.0, 1), BLOCK, NO_VALUE),
        ("duty", put(BLOCK, 255.0, 1), BLOCK, NO_VALUE),
        ("duty", put(THIRD, -1.0 / 4095.0), THIRD, NO_VALUE),
        ("rotor_rev_s", put(BLOCK, -1.0 / 60.0, 1), BLOCK, NO_VALUE),
        ("battery_v", put(THIRD, 65535.0), THIRD, "battery is exactly 65535 V"),
        (
            "battery_v",
            put(slice(3000), 0.0),
            slice(3000),
            f"is exactly 0 V in 3000 of 9990 samples, {NO_VALUE}",
        ),
    ],
)
def test_rows_of_which_something_cannot_be_measured_are_missing_and_no_others(
    flight, field, change, rows, words
):
    if field == "rotor_rev_s":
        flight = changed(flight, field, lambda values: values.__setitem__(..., 300 * flight.duty))
    if field == "attitude":
        flight = changed(flight, "gyro", swing)
    left, said, verdict = judged(changed(flight, field, change))
    lost = np.zeros(len(flight), bool)
    lost[rows] = True
    assert np.array_equal(missing(left, field), lost)
    assert len(said) == (4 if rows == THIRD and field == "duty" else 1), said
    assert all(words in one for one in said), said
    assert said[0].removeprefix("made.csv: taken as missing: ") in verdict
    assert "went down" not in verdict


def test_a_sensor_that_does_not_change_on_the_ground_is_not_frozen(flight):
    assert not (flight.duty[:900] > 0.05).all(axis=1).any()
    _, said, _ = judged(changed(flight, "gyro", keep(0, 900)))
    assert said == []


@pytest.mark.parametrize(
    ("change", "lost", "words"),
    [
        (put(slice(None), 150.0, 2), slice(None), "rotor_3 is 9000 throughout"),
        (put(slice(6000, None), 0.0, 2), slice(6000, None), "rotor_3 is stuck"),
    ],
)
def test_a_rotor_s_dead_sensor_is_missing_and_the_others_stay(flight, change, lost, words):
    left, said, _ = judged(changed(flight, "rotor_rev_s", change))
    assert np.isnan(left.rotor_rev_s[lost, 2]).all()
    assert np.isfinite(left.rotor_rev_s[:, [0, 1, 3]]).all()
    assert words in said[0]


def test_a_motor_that_is_never_driven_is_told_and_believed(flight):
    bench = changed(flight, "duty", put(slice(None), 0.0, slice(1, None)))
    assert any("duty_2 is 0 throughout" in one.words for one in rejections(bench))
    assert np.isfinite(judged(bench)[0].duty).all()


def test_two_blows_as_hard_as_each_other_are_no_sign_of_no_value(flight):
    blows = put([4000, 6000], 150.0, 2)
    left, said, _ = judged(changed(flight, "accelerometer", blows))
    assert (missing(left, "accelerometer").sum(), said) == (0, [])


def test_an_attitude_that_never_changes_while_the_gyro_turns_is_missing(flight):
    turning = changed(flight, "gyro", swing)
    left, said, verdict = judged(changed(turning, "attitude", put(slice(None), [0.0, 0.0, 0.3])))
    assert missing(left, "attitude").all()
    assert "the attitude never changes while the gyro turns" in said[0]
    assert "the attitude never changes while the gyro turns" in verdict
    left, said, _ = judged(changed(turning, "attitude", put(slice(None), 0.0, 1)))
    assert np.isnan(left.attitude[:, 1]).all()
    assert "pitch never changes while the gyro turns" in said[0]


def test_a_yaw_of_ten_million_degrees_cannot_be_and_one_that_counts_turns_can(flight):
    def turns(angles):
        angles[:, 2] = np.linspace(0.0, np.radians(5000.0), len(angles))

    def nonsense(angles):
        angles[5000:, 2] = np.linspace(0.0, 1e7, len(angles) - 5000)

    assert not missing(judged(changed(flight, "attitude", turns))[0], "attitude").any()
    left, said, _ = judged(changed(flight, "attitude", nonsense))
    assert missing(left, "attitude")[5100:].all()
    assert "yaw up to" in said[0]


@pytest.mark.parametrize(
    ("duty", "said"),
    [
        (0.0, "the motors are off throughout while the craft turns: it was moved by hand, or"),
        (0.55, "the motors' duty is 0.55 throughout though the craft turns"),
    ],
)
def test_motors_that_never_change_while_the_craft_turns_are_a_fault(flight, duty, said):
    turning = changed(flight, "gyro", swing)
    _, _, verdict = judged(changed(turning, "duty", lambda values: values.fill(duty)))
    assert said in verdict
