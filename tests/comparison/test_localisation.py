"""The places where model and flight disagree lead to what was hidden."""

import dataclasses

import numpy as np
import pytest

from groundstation.comparison.comparison import over_time, spectrum_of, where, worst_stretch
from support.flights import MEDIUM, hidden, judged


@pytest.mark.parametrize(
    ("name", "channels", "regimes"),
    [
        ("rotor_acceleration_torque", ("gyro_z",), ("rotors slowing down", "rotor acceleration")),
        ("velocity_moment", ("gyro_x", "gyro_y"), ("translation",)),
        ("yaw_damping", ("gyro_z",), ("high yaw rate",)),
        ("ground_effect", ("accelerometer_z",), ("near ground",)),
        ("gyro_bias", ("roll", "pitch", "yaw"), ("whole flight",)),
    ],
)
def test_the_first_place_is_where_the_hidden_effect_acts(name, channels, regimes):
    first = judged(effects=hidden(name, MEDIUM[name])).places[0]
    assert first.channel in channels
    assert first.regime in regimes
    assert first.significance > 3.0
    assert first.rms > first.expected_rms


def test_a_clean_flight_has_no_place_worth_naming():
    assert judged().places[0].significance < 3.0


def test_the_worst_stretch_is_one_in_which_the_excess_is_largest():
    found = judged(effects=hidden("yaw_damping", MEDIUM["yaw_damping"]))
    stretch = worst_stretch(found.errors, found.floors, "gyro_z")
    error = found.errors[stretch.run].horizons[-1][:, 2]
    inside = np.nanmean(error[stretch.first : stretch.last] ** 2)
    assert inside > 3 * np.nanmean(error**2)


def test_over_time_the_error_stands_out_where_the_craft_turns():
    found = judged(effects=hidden("yaw_damping", MEDIUM["yaw_damping"]))
    one = found.errors[0]
    time, ratio = over_time(one, found.floors[0])
    turning = np.interp(time, one.run.time_s, np.abs(one.run.gyro[:, 2]))
    known = np.isfinite(ratio[:, 2])
    assert np.corrcoef(turning[known], ratio[known, 2])[0, 1] > 0.5
    assert np.isnan(ratio[0]).all()  # at rest before the take-off


def test_the_spectrum_of_a_slow_push_rises_above_noise_at_low_frequency_only():
    found = judged(effects=hidden("velocity_moment", MEDIUM["velocity_moment"]))
    shown = spectrum_of(found.errors, found.floors, "gyro_y")
    ratio = shown.error / shown.expected
    assert ratio[1] > 5.0
    assert np.median(ratio[shown.frequency_hz > 50.0]) == pytest.approx(1.0, abs=0.1)


def test_rows_of_which_nothing_foretells_the_noise_count_in_no_place():
    found = judged(effects=hidden("yaw_damping", MEDIUM["yaw_damping"]))
    whole = {(one.channel, one.regime): one.expected_rms for one in found.places}
    floors = [
        dataclasses.replace(one, horizons=[half_known(values) for values in one.horizons])
        for one in found.floors
    ]
    for place in where(found.errors, floors):
        assert 0.2 < place.expected_rms / whole[place.channel, place.regime] < 5.0


def half_known(values):
    known = values.copy()
    known[len(values) // 2 : len(values) // 2 + 50] = np.nan
    return known
