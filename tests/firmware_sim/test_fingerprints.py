"""A stand-in's log cannot be told from the real excerpt by the fingerprints we know."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from firmware_sim.craft import StandIn, StandInSettings
from groundstation.recording.csv_file import read_csv
from groundstation.telemetry.samples import packet_counts
from support import fingerprints
from support.plant import flown, programme, rows_of

EXCERPT = Path(__file__).parents[2] / "recordings" / "thesis_excerpt.csv"


def hover() -> dict[str, np.ndarray]:
    """A stretch of hover, rows 3500 to 14500."""
    rows = flown(30.0, program="hover", seed=11)[1]
    return {name: values[3500:14500] for name, values in rows.items()}


@pytest.fixture(scope="module", params=["real excerpt", "stand-in"])
def counts(request):
    if request.param == "stand-in":
        return hover()
    return packet_counts(read_csv(EXCERPT).samples)


@pytest.fixture(scope="module")
def stand_in():
    return hover()


def test_a_row_comes_every_1972_6_ticks(counts):
    assert fingerprints.mean_timestamp_step(counts) == pytest.approx(1972.6, abs=0.5)


def test_the_timestamps_jitter_by_a_few_ticks(counts):
    steps = np.diff(counts["timestamp"])
    assert 1.0 < steps.std() < 6.0
    assert np.abs(steps - 1972.6).max() < 30


def test_every_motor_value_is_a_multiple_of_eight(counts):
    assert (counts["motors"] % 8 == 0).all()
    assert counts["motors"].max() <= 4088


@pytest.mark.parametrize("axis", ["roll", "pitch"])
def test_the_motors_answer_the_gyro_of_the_row_before_with_the_stock_gain(counts, axis):
    slope = fingerprints.rate_gain(counts, axis)
    assert slope.value == pytest.approx(fingerprints.STOCK_SLOPES[axis], rel=0.02)
    assert abs(slope.correlation) > 0.98
    same_row = fingerprints.rate_gain(counts, axis, lag_rows=0)
    assert np.sign(same_row.value) == -np.sign(slope.value)  # the shaking alternates


def test_the_yaw_motors_answer_with_the_stock_gain(stand_in):
    """The stand-in alone: the excerpt's 25 rows are too few for 2 % on a quiet axis."""
    assert fingerprints.rate_gain(stand_in, "yaw").value == pytest.approx(
        fingerprints.STOCK_SLOPES["yaw"], rel=0.02
    )


@pytest.mark.parametrize("angle", ["roll", "pitch"])
def test_the_angles_change_every_second_row(counts, angle):
    gaps = fingerprints.rows_between_angle_changes(counts, angle)
    assert (gaps % 2 == 0).all()
    assert np.median(gaps) == 2


@pytest.mark.parametrize(("angle", "sign"), [("roll", 1), ("pitch", -1)])
def test_the_angles_follow_the_gyro_with_pitch_nose_up(counts, angle, sign):
    assert np.sign(fingerprints.angle_per_gyro(counts, angle).value) == sign


def test_the_accelerometer_shakes_near_the_nyquist_rate(counts):
    x = counts["accelerometer"][:, 0].astype(float)
    x -= x.mean()
    changes = (np.sign(x[1:]) != np.sign(x[:-1])).mean()
    assert changes > 0.8
    assert 300 < x.std() < 2500


def test_the_mean_accelerometer_is_near_one_g(counts):
    assert fingerprints.mean_accelerometer_counts(counts) == pytest.approx(4096, rel=0.2)


@pytest.mark.parametrize("craft", ["crazyflie1", "crazyflie21"])
@pytest.mark.parametrize("level", [26000, 38000, 46000])
def test_the_rotors_show_in_the_accelerometer_at_their_alias(tmp_path, craft, level):
    rest, bench = {"kind": "rest", "seconds": 3}, {"kind": "bench", "seconds": 30, "thrust": level}
    path = programme(tmp_path, rest, bench)
    stand_in = StandIn(
        StandInSettings(craft=craft, firmware="2014", program=path, supply_v=3.7, truth=True)
    )
    rows = rows_of(stand_in.advance(12.0)[0])
    x = rows["accelerometer"][3000:5900, 0].astype(float)
    spectrum = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x))))
    peak_hz = np.fft.rfftfreq(len(x), 0.002)[spectrum.argmax()]
    speed = stand_in.truth()["rotor_rev_s"][3000:5900].mean(axis=0)
    fold_hz = np.abs(speed - 500 * np.round(speed / 500))
    assert np.abs(peak_hz - fold_hz).min() < 1.0
