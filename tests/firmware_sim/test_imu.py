"""The sensor: ranges, steps, delay, its own clock, drift."""

from __future__ import annotations

import math

import numpy as np
import pytest

from firmware_sim.imu import register
from firmware_sim.physics import DLPF, present_effects
from firmware_sim.settings import Sensor, StandInSettings
from support.plant import QUIET, callable_piece, craft_after, flown, programme


def turned(program, seconds: float = 20.0, **settings):
    """(truth, telemetry) of a craft that a hand turns."""
    craft, rows = flown(seconds, truth=True, program=program, **QUIET, **settings)
    return craft.truth()[: len(rows["gyro"])], rows


def delay_of(truth, actual, seen):
    """By the best shift, s."""
    shifts, window = np.arange(0.0, 0.03, 0.0001), slice(2500, len(truth) - 100)
    past = truth["time_s"][window]
    errors = [
        np.square(np.interp(past - shift, truth["time_s"], actual) - seen[window]).sum()
        for shift in shifts
    ]
    return shifts[int(np.argmin(errors))]


def gyro_delay_of(truth, rows):
    return delay_of(truth, truth["rate_rad_s"][:, 0], np.radians(rows["gyro"][:, 0] / 16.384))


@pytest.fixture(scope="module")
def turning(tmp_path_factory):
    sine = {"axis": "roll", "shape": "sine", "amplitude": 40, "period_s": 1.0}
    segments = {"kind": "hand", "seconds": 3}, {"kind": "hand", "seconds": 30, "excite": [sine]}
    return programme(tmp_path_factory.mktemp("programme"), *segments)


DATA_SHEET = {  # DLPF_CFG: gyro Hz, ms, accelerometer Hz, ms
    1: (188, 1.9, 184, 2.0),
    2: (98, 2.8, 94, 3.0),
    3: (42, 4.8, 44, 4.9),
    4: (20, 8.3, 21, 8.5),
    5: (10, 13.4, 10, 13.8),
    6: (5, 18.6, 5, 19.0),
}


def test_the_low_pass_settings_are_the_data_sheets():
    written = {k: (g[0], 1e3 * g[1], a[0], 1e3 * a[1]) for k, (g, a) in DLPF.items()}
    assert written.keys() == DATA_SHEET.keys()
    for setting, row in DATA_SHEET.items():
        assert written[setting] == pytest.approx(row)


@pytest.mark.parametrize("setting", sorted(DATA_SHEET))
def test_the_accelerometer_is_as_late_as_the_data_sheet_says(turning, setting):
    sensor = Sensor(dlpf=setting, phase_s=0.0007, clock_ppm=0.0, shake=(0.0, 0.0, 0.0))
    truth, rows = turned(turning, sensor=sensor)
    w, x, y, z = truth["quaternion"].T
    sideways = 2 * (y * z + w * x)  # gravity's share along the body's y, g
    age_s = truth["sensor_age_s"][-1]
    gyro_ms, accel_ms = DATA_SHEET[setting][1], DATA_SHEET[setting][3]
    gyro_lag_s = min(1 / (2 * math.pi * DATA_SHEET[setting][0]), gyro_ms * 1e-3)
    expected = age_s + gyro_lag_s + (accel_ms - gyro_ms) * 1e-3
    seen = rows["accelerometer"][:, 1] / 4096
    assert delay_of(truth, sideways, seen) == pytest.approx(expected, abs=0.2e-3)


@pytest.mark.parametrize("setting", sorted(DLPF))
def test_the_data_sheets_delay_plus_bus_plus_wait_comes_out(turning, setting):
    sensor = Sensor(dlpf=setting, phase_s=0.0007, clock_ppm=0.0, shake=(0.0, 0.0, 0.0))
    truth, rows = turned(turning, sensor=sensor)
    delay = gyro_delay_of(truth, rows)
    bandwidth_hz, data_sheet_s = DATA_SHEET[setting][0], DATA_SHEET[setting][1] * 1e-3
    lag = min(1 / (2 * math.pi * bandwidth_hz), data_sheet_s)
    age = truth["sensor_age_s"][-1]
    wait = age + lag - data_sheet_s - 0.4e-3
    assert 0 <= wait <= 2e-3
    assert delay == pytest.approx(data_sheet_s + 0.4e-3 + wait, abs=0.3e-3)


def test_a_total_delay_of_the_thesis_s_eight_samples_can_be_set(turning):
    sensor = Sensor(dlpf=2, delay_s=0.016, clock_ppm=30.0, shake=(0.0, 0.0, 0.0))
    delay = gyro_delay_of(*turned(turning, seconds=33.0, sensor=sensor))
    assert delay == pytest.approx(0.016, abs=1.1e-3)  # the wait for the loop is 0..2 ms


def test_todays_estimator_is_as_late_as_the_filtered_gyro_that_it_turns_by(turning):
    truth, rows = turned(turning, craft="crazyflie21", plant="reduced")
    w, x, y, z = truth["quaternion"].T
    roll = np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    gyro = gyro_delay_of(truth, rows)
    angle = delay_of(truth, roll, np.radians(rows["angles"][:, 0] / 100.0))
    assert gyro == pytest.approx(math.sqrt(2.0) / (2.0 * math.pi * 80.0), abs=0.6e-3)
    # angles are new on every second row: half a row later on average
    assert angle == pytest.approx(gyro + 1e-3, abs=0.3e-3)


def test_the_faithful_sensor_is_about_3_3_ms_old_on_average():
    delays = []
    for seed in range(40):
        craft = craft_after(1.0, seed=seed, truth=True, program="wait")
        delays.append(craft.truth()["sensor_age_s"].mean() + 1 / (2 * math.pi * 188))
    stated = present_effects(StandInSettings())["dead_time"]["delay_s"]
    assert np.mean(delays) == pytest.approx(stated, abs=0.25e-3)
    assert min(delays) > 2.2e-3
    assert max(delays) < 4.4e-3


def test_the_sensors_clock_is_not_the_loops():
    sensor = Sensor(phase_s=0.0, clock_ppm=200.0)
    craft = craft_after(21.0, truth=True, program="wait", sensor=sensor)
    age = craft.truth()["sensor_age_s"]
    assert age.max() - age.min() == pytest.approx(2e-3, rel=0.05)
    assert np.abs(np.diff(age)).max() > 1.9e-3  # now and then a sample is read twice


@pytest.mark.parametrize(
    ("counts", "stored"),
    [(0.4, 0), (0.6, 1), (-0.6, -1), (32767.4, 32767), (1e9, 32767), (-1e9, -32768)],
)
def test_a_register_rounds_and_saturates(counts, stored):
    assert callable_piece(register)(counts) == stored


def test_the_gyro_saturates_at_2000_degrees_per_second():
    sensor = Sensor(gyro_bias_dps=(3000.0, -3000.0, 0.0))
    _, rows = flown(2.0, program="wait", sensor=sensor)
    assert set(rows["gyro"][50:, 0]) == {32767}
    assert set(rows["gyro"][50:, 1]) == {-32768}


def test_the_gyro_drifts_while_it_warms_up():
    sensor = Sensor(warm_up_drift_dps=(2.0, 0.0, 0.0), warm_up_s=5.0)
    _, rows = flown(20.0, program="wait", sensor=sensor)
    drift = rows["gyro"][:, 0] / 16.384
    assert drift[100:300].mean() == pytest.approx(2 * (1 - math.exp(-0.4 / 5)), abs=0.05)
    assert drift[-500:].mean() == pytest.approx(2 * (1 - math.exp(-19.5 / 5)), abs=0.05)


def test_noise_scales():
    spreads = [
        flown(5.0, plant="reduced", program="wait", sensor_noise=scale)[1]["gyro"][1600:, 0].std()
        for scale in (1.0, 6.0)
    ]
    assert spreads[0] == pytest.approx(0.10 * 16.384, rel=0.1)
    assert spreads[1] == pytest.approx(6 * 0.10 * 16.384, rel=0.1)
