"""Height is reckoned near the ground, through a low hover and down to the touch-down."""

import numpy as np
import pytest

from groundstation.prediction.drive import heights_of, rise_of
from groundstation.telemetry.samples import spans
from support.flights import recorded

PROGRAMME = """name = "low"
[[segment]]
kind = "rest"
seconds = 3.0
[[segment]]
kind = "fly"
seconds = 3.0
height_m = 0.08
[[segment]]
kind = "fly"
seconds = {high_s}
height_m = 0.8
[[segment]]
kind = "fly"
seconds = {low_s}
height_m = {low_m}
[[segment]]
kind = "rest"
seconds = 2.0
"""


def flown(folder, high_s, low_s, low_m):
    """(vertical acceleration, still rows, start, stop, true height) of a flight that ends low."""
    path = folder / "low.toml"
    path.write_text(PROGRAMME.format(high_s=high_s, low_s=low_s, low_m=low_m))
    samples, truth = recorded(
        8.0 + high_s + low_s,
        plant="reduced", seed=4, program=str(path), copies=1, loss={"good_loss": 0.0},
    )  # fmt: skip
    rise = rise_of(samples.attitude.astype(float), samples.accelerometer.astype(float))
    ((start, stop),) = spans(np.asarray((samples.duty > 0.1).all(axis=1)))
    still = np.asarray((samples.duty <= 0.0).all(axis=1))
    return rise, still, start, stop, truth["position_m"][: len(rise), 2]


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    return flown(tmp_path_factory.mktemp("programme"), 14.0, 2.0, 0.0)


def test_height_is_known_to_a_few_centimetres_after_take_off_and_before_a_short_landing(flight):
    rise, still, start, stop, true = flight
    height, low = heights_of(rise, still, start, stop, 0.002)
    error = height - true[start:stop]
    assert low == 0
    assert np.abs(error[:1500]).max() < 0.05
    assert np.abs(error[-500:]).max() < 0.05
    assert np.isinf(height[len(height) // 2])


def test_before_a_long_landing_it_is_not_known_and_how_long_the_craft_may_be_low_is_said(tmp_path):
    rise, still, start, stop, true = flown(tmp_path, 40.0, 4.0, 0.08)
    height, low = heights_of(rise, still, start, stop, 0.002)
    error = height - true[start:stop]
    assert np.abs(error[:1500]).max() < 0.05
    assert np.isinf(height[-3000:]).all()
    assert (true[start : stop - low][5000:] > 0.3).all()
    assert true[stop - low] < 0.85


def test_a_recording_that_breaks_off_over_the_ground_says_from_where_on_it_may_have_landed(flight):
    rise, still, start, stop, true = flight
    cut = stop - 100
    _, low = heights_of(rise[:cut], still[:cut], start, cut, 0.002)
    assert low > 0
    assert true[cut - low - 1] == pytest.approx(0.35, abs=0.15)
    high = start + 5000
    assert heights_of(rise[:high], still[:high], start, high, 0.002)[1] == 0


def test_a_flight_that_was_in_the_air_already_has_no_height(flight):
    rise, still, start, stop, _ = flight
    begun = start + 2000
    height, low = heights_of(rise[begun:], still[begun:], 0, stop - begun, 0.002)
    assert np.isinf(height).all()
    assert low == 0


def test_rows_without_a_new_attitude_are_risen_in_as_well():
    generator = np.random.default_rng(2)
    attitude = np.cumsum(generator.normal(0.0, 2e-3, (3000, 3)), axis=0)
    accelerometer = generator.normal([0.0, 0.0, 10.0], 0.5, (3000, 3))
    true = rise_of(attitude, accelerometer)
    attitude[np.arange(3000) % 3 != 0] = np.nan
    accelerometer[700:705] = np.nan
    told = rise_of(attitude, accelerometer)
    assert told.sum() == pytest.approx(true.sum(), rel=0.01)
    assert np.abs(told - true).mean() < 0.02


def test_a_craft_that_drops_the_last_centimetres_came_down_where_the_ground_stops_it(tmp_path):
    rise, still, start, stop, true = flown(tmp_path, 14.0, 1.9, 0.0)
    assert 0.01 < true[stop] < 0.03
    height, _ = heights_of(rise, still, start, stop, 0.002)
    assert height[-1] == pytest.approx(true[stop - 1], abs=0.004)


def test_a_bounce_is_not_the_touch_down():
    period = 0.002
    up = np.repeat([0.0, 2.0, -2.0, -0.9], [500, 250, 250, 500])  # rest, half a metre up, and down
    speed = np.cumsum(up) * period
    stop, low = len(up), float(np.sum(speed) * period)
    assert 0.04 < low < 0.06
    rows = round((speed[-1] + (speed[-1] ** 2 + 2 * 9.8 * low) ** 0.5) / 9.8 / period)
    fall, struck = np.full(rows, -9.8), [80.0]
    bounce = np.concatenate([fall, struck, np.full(40, -9.8), struck, np.zeros(400)])
    rise = np.concatenate([up, bounce])
    still = np.arange(len(rise)) < 500
    height, _ = heights_of(rise, still, 500, stop, period)
    assert height[-1] == pytest.approx(low, abs=0.005)
