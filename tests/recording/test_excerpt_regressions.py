"""The thesis's log excerpt (figure 5.7) repeats what is known about the real flight."""

from pathlib import Path

import numpy as np
import pytest

from groundstation.recording.csv_file import read_csv
from groundstation.telemetry.packet import MOTOR_STEP, SAMPLE_TICKS
from groundstation.telemetry.samples import packet_counts
from support.fingerprints import (
    STOCK_SLOPES,
    angle_per_gyro,
    mean_accelerometer_counts,
    mean_timestamp_step,
    rate_gain,
    rows_between_angle_changes,
)

EXCERPT = Path(__file__).parents[2] / "recordings" / "thesis_excerpt.csv"


@pytest.fixture(scope="module")
def counts():
    return packet_counts(read_csv(EXCERPT).samples)


def test_the_excerpt_has_the_25_rows_of_the_figure(counts):
    assert len(counts["timestamp"]) == 25
    assert counts["timestamp"][[0, -1]].tolist() == [17114118, 17161461]
    assert counts["gyro"][-1].tolist() == [-902, -670, -120]
    assert set(counts["debug"]) == {1230000000}


def test_the_timestamp_steps_by_the_ticks_of_two_milliseconds(counts):
    assert mean_timestamp_step(counts) == pytest.approx(1972.6, abs=0.05)
    assert mean_timestamp_step(counts) == pytest.approx(SAMPLE_TICKS, rel=1e-4)


def test_every_motor_value_is_a_multiple_of_eight(counts):
    assert MOTOR_STEP == 8
    assert np.all(counts["motors"] % 8 == 0)


@pytest.mark.parametrize(
    ("axis", "slope", "correlation"),
    [("roll", -4.275, -0.9995), ("pitch", 4.318, 0.9997), ("yaw", 3.069, 0.997)],
)
def test_the_motors_answer_the_gyro_of_the_row_before(counts, axis, slope, correlation):
    measured = rate_gain(counts, axis)
    assert measured.value == pytest.approx(slope, abs=0.002)
    assert measured.correlation == pytest.approx(correlation, abs=0.0005)
    assert measured.value == pytest.approx(STOCK_SLOPES[axis], rel=0.015)


@pytest.mark.parametrize("axis", ["roll", "pitch", "yaw"])
def test_the_same_row_answers_with_the_opposite_sign(counts, axis):
    """The vibration alternates every row: the sign tells which row was answered."""
    assert np.sign(rate_gain(counts, axis, lag_rows=0).value) == -np.sign(STOCK_SLOPES[axis])


def test_the_mean_accelerometer_is_a_little_over_one_g(counts):
    assert mean_accelerometer_counts(counts) == pytest.approx(4655, abs=1)


@pytest.mark.parametrize("angle", ["roll", "pitch"])
def test_the_angles_change_every_second_row(counts, angle):
    assert rows_between_angle_changes(counts, angle).tolist() == [2] * 11


@pytest.mark.parametrize(("angle", "slope"), [("roll", 0.029), ("pitch", -0.031)])
def test_an_angle_follows_its_gyro_and_the_packet_s_pitch_is_nose_up(counts, angle, slope):
    measured = angle_per_gyro(counts, angle)
    assert measured.value == pytest.approx(slope, abs=0.0005)
    assert abs(measured.correlation) > 0.99
