"""The answer key."""

from __future__ import annotations

import pytest

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.effects.catalogue import EFFECTS
from firmware_sim.present import present_effects

SIZES = {
    "centre_of_gravity_offset": {"x_m": 5e-4, "y_m": 0.0},
    "gyro_bias": {"x_dps": 1.0, "y_dps": 0.0, "z_dps": 0.5},
    "accelerometer_bias": {"x_g": 0.0, "y_g": 0.0, "z_g": 0.02},
    "imu_misalignment": {"roll_deg": 0.0, "pitch_deg": 2.0, "yaw_deg": 0.0},
    "imu_lever_arm": {"x_m": 0.003, "y_m": 0.0, "z_m": 0.0},
}
LISTED = sorted(name for name, effect in EFFECTS.items() if effect.listed)


def test_a_clean_craft_contains_nothing():
    assert present_effects(StandInSettings(plant="reduced")) == {}


@pytest.mark.parametrize("name", LISTED)
def test_a_hidden_effect_is_present_with_its_size(name):
    defaults = {key: default for key, (default, _) in EFFECTS[name].parameters.items()}
    values = SIZES.get(name, defaults)
    found = present_effects(StandInSettings(plant="reduced", effects={name: values}))
    assert found == {name: pytest.approx(values, rel=1e-6, abs=1e-12)}


def test_the_faithful_craft_always_contains_the_stated_six():
    found = present_effects(StandInSettings())
    assert set(found) == {
        "battery_reading_lag",
        "attitude_filter_lean",
        "dead_time",
        "inertia_coupling",
        "rotor_gyroscopic_torque",
        "rotor_acceleration_torque",
        "supply_sag",
    }
    assert found["dead_time"]["delay_s"] == pytest.approx(3.3e-3, abs=0.05e-3)
    assert found["battery_reading_lag"]["time_constant_s"] == pytest.approx(0.155, abs=0.01)
    assert found["rotor_gyroscopic_torque"] == found["rotor_acceleration_torque"]


def test_the_stated_delay_is_that_of_flights():
    ages = []
    for seed in range(40):
        craft = StandIn(StandInSettings(seed=seed, program="wait", truth=True))
        craft.advance(0.5)
        ages.append(craft.truth()["sensor_age_s"].mean())
    lag_s = 1 / (2 * 3.141592653589793 * 188)
    stated = present_effects(StandInSettings())["dead_time"]["delay_s"]
    assert sum(ages) / len(ages) + lag_s == pytest.approx(stated, abs=0.25e-3)
