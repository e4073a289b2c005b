"""From settings, profiles and models to a craft: numbers kept, nonsense refused, effects told."""

from __future__ import annotations

import msgspec
import pytest

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.effects.catalogue import EFFECTS
from firmware_sim.physics import present_effects, realize
from firmware_sim.settings import Loss, Sensor
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from support.plant import flown


@pytest.mark.parametrize("name", ["crazyflie1", "crazyflie21"])
def test_a_model_gives_back_its_own_constants_as_a_craft(name):
    model = vehicle_model(load_vehicle(name))
    body = model.body
    assert body is not None
    faster = msgspec.structs.replace(body, c0=2.5 * body.c0, c1=2.0 * body.c1, c2=3.0 * body.c2)
    craft = realize(msgspec.structs.replace(model, body=faster))
    assert craft.body_constants == pytest.approx((faster.c0, faster.c1, faster.c2))
    assert craft.thrust_per_mass == pytest.approx(body.thrust_per_mass)
    before, after = load_vehicle(name).inertia_kg_m2, craft.inertia_kg_m2
    assert after[2] / (after[0] + after[1]) == pytest.approx(before[2] / (before[0] + before[1]))


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"sensor": {"dlpf": 7}}, r"dlpf is 7.*\$\.sensor"),
        ({"sensor": {"clock_ppm": -1e6}}, "clock_ppm"),
        ({"sensor": {"phase_s": 0.01}}, "phase_s"),
        ({"sensor": {"shake": [0.1, -0.1, 0.0]}}, "shake"),
        ({"loss": {"good_loss": 1.5}}, r"good_loss is 1.5.*\$\.loss"),
        ({"substeps": 0}, "substeps is 0"),
        ({"copies": 0}, "copies is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"charge": 1.2}, "charge is 1.2"),
        ({"supply_v": 0.0}, "supply_v is 0.0"),
    ],
)
def test_settings_that_no_craft_can_have_are_refused(document, message):
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.convert(document, StandInSettings)


def test_numbers_that_are_none_are_refused():
    with pytest.raises(ValueError, match="torque_noise is nan"):
        StandInSettings(torque_noise=float("nan"))
    with pytest.raises(ValueError, match="roll_kp is inf"):
        StandInSettings(gains={"pid_rate.roll_kp": float("inf")})


@pytest.mark.parametrize(
    ("effect", "parameters", "message"),
    [
        ("dead_time", {"delay_s": -0.001}, "delay_s is -0.001"),
        ("dead_time", {"delay_s": 0.1}, r"in \[0, 0.04\]"),
        ("rotor_mismatch", {"rotor": 0}, "rotor is 0"),
        ("rotor_mismatch", {"rotor": 2.5}, "1, 2, 3 or 4"),
        ("cracked_arm", {"rotor": 9}, "rotor is 9"),
        ("ground_effect", {"height_m": 0.0}, "height_m is 0"),
        ("motor_braking_asymmetry", {"factor": -1.0}, "factor is -1"),
        ("slung_load", {"length_m": 0.0}, "length_m is 0"),
    ],
)
def test_a_size_that_cannot_be_flown_is_refused(effect, parameters, message):
    with pytest.raises(ValueError, match=message):
        StandIn(StandInSettings(effects={effect: parameters}))


@pytest.mark.parametrize(
    ("name", "parameter"),
    [(name, key) for name in sorted(EFFECTS) for key in EFFECTS[name].parameters],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_size_that_nobody_meant_is_refused(name, parameter, sign):
    with pytest.raises(ValueError, match=rf"{name}.*{parameter} is "):
        StandIn(StandInSettings(effects={name: {parameter: sign * 1e12}}))


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_a_size_that_is_no_number_is_refused(name):
    for parameter in EFFECTS[name].parameters:
        with pytest.raises(ValueError, match=rf"{name}.*{parameter} is nan"):
            StandIn(StandInSettings(effects={name: {parameter: float("nan")}}))


def test_a_delay_longer_than_the_sensors_memory_is_refused():
    settings = StandInSettings(
        sensor=Sensor(delay_s=0.05), effects={"dead_time": {"delay_s": 0.03}}
    )
    with pytest.raises(ValueError, match="ms of delay, must be at most 60"):
        StandIn(settings)


@pytest.mark.parametrize("first", ["dead_time", "attitude_filter_lean"])
def test_a_hidden_delay_is_the_same_in_any_company_and_order(first):
    effects = {"dead_time": {"delay_s": 0.003}, "attitude_filter_lean": {}}
    ordered = {first: effects[first], **effects}
    craft, _ = flown(2.0, plant="reduced", truth=True, effects=ordered, loss=Loss(good_loss=0.0))
    assert craft.truth()["sensor_age_s"][100:] == pytest.approx(0.003, abs=1e-6)


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
