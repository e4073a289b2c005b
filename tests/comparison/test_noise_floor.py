"""The noise floor is what a perfect model leaves, found without one."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.comparison.comparison import compare
from groundstation.comparison.gap import CHANNELS
from groundstation.comparison.noise_floor import floor_errors, learn, prepare
from groundstation.dynamics.model import model_vehicle
from support.flights import BASE, MEDIUM, affected, hidden, judged
from support.flights import compared as flights

NOISY = {"torque_noise": 6.0, "sensor_noise": 2.0}


def gaps(comparison, floor=None):
    floor = comparison.noise_floor if floor is None else floor
    return dict(zip(CHANNELS, comparison.rms / floor, strict=True))


@pytest.mark.parametrize("noise", [{}, NOISY], ids=["1x", "6x"])
def test_the_true_model_of_a_clean_flight_has_a_gap_of_one_on_every_channel(noise):
    clean = judged(**noise)
    for channel, gap in gaps(clean).items():
        assert gap == pytest.approx(1.0, abs=0.03), channel
    assert clean.gap == pytest.approx(1.0, abs=0.015)


def test_lost_rows_leave_the_gap_of_a_clean_flight_at_one():
    for channel, gap in gaps(judged(loss=0.02)).items():
        assert gap == pytest.approx(1.0, abs=0.03), channel


@pytest.mark.parametrize(
    ("name", "channel"),
    [
        ("dead_time", "gyro_z"),
        ("supply_sag", "accelerometer_z"),
    ],
)
def test_the_model_that_knows_the_effect_comes_down_to_the_floor_of_the_one_that_does_not(
    name, channel
):
    before = judged(effects=hidden(name, MEDIUM[name]))
    after = before.with_model(affected(name))
    assert gaps(before)[channel] > 1.3
    for where, gap in gaps(after).items():
        assert 0.85 < gap < 1.05, where
    number = CHANNELS.index(channel)
    gained = before.rms[number] ** 2 - after.rms[number] ** 2
    assert gained / (before.rms[number] ** 2 - before.noise_floor[number] ** 2) >= 0.9


def test_the_floor_does_not_know_the_model_that_is_judged():
    before = judged(effects=hidden("supply_sag", MEDIUM["supply_sag"]))
    after = before.with_model(affected("supply_sag"))
    np.testing.assert_array_equal(after.noise_floor, before.noise_floor)


def test_vibration_belongs_to_the_floor_and_a_gust_does_not():
    shaken = gaps(judged(plant="faithful"))
    assert shaken["accelerometer_x"] < 1.3
    pushed = judged(effects=hidden("side_gust", {}))
    assert gaps(pushed)["accelerometer_y"] > 1.5
    assert pushed.places[0].channel == "accelerometer_y"


@pytest.mark.parametrize("lost", ["attitude", "accelerometer"])
def test_without_a_channel_the_others_keep_their_gap(lost):
    runs = [replace(run, **{lost: np.full((len(run), 3), np.nan)}) for run in flights(1)]
    found = gaps(compare(runs, BASE))
    missing = slice(6, 9) if lost == "attitude" else slice(3, 6)
    for number, channel in enumerate(CHANNELS):
        if number in range(9)[missing]:
            assert np.isnan(found[channel])
        else:
            assert found[channel] == pytest.approx(1.0, abs=0.03), channel


def test_signals_are_chosen_once_for_all_horizons(monkeypatch):
    near = judged(effects=hidden("velocity_moment", MEDIUM["velocity_moment"]))
    far = near.further()
    layout = model_vehicle(near.model).configuration
    (made,) = (prepare(one, layout) for one in far.errors)
    afresh = floor_errors(learn([made]), made)
    monkeypatch.setattr("groundstation.comparison.noise_floor.fit_signals", None)
    known = floor_errors(learn([made], far.black_box), made)
    for one in (*far.floors, known):
        np.testing.assert_array_equal(one.step, afresh.step)
        np.testing.assert_array_equal(one.horizons, afresh.horizons)
