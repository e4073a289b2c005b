"""A fitted model flies as it was fitted: its effects stand in the place of the plant's."""

from __future__ import annotations

import functools
import math

import msgspec
import pytest

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.hide import HIDEABLE, main
from firmware_sim.physics import present_effects
from firmware_sim.settings import load_settings
from groundstation.dynamics.model import EffectTerm, Estimate, load_model, save_model, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.body import identify_body
from groundstation.identification.runs import runs_of
from support.flights import recorded
from support.plant import craft_after

CRAFTS = ("crazyflie1", "crazyflie21")
UNLIKE_THE_PLANT = {
    "dead_time": {"delay_s": 0.0041},
    "battery_reading_lag": {"time_constant_s": 0.2},
    "supply_sag": {"resistance_ohm": 0.11},
    "inertia_coupling": {"fraction": 0.9},
    "rotor_gyroscopic_torque": {"rotor_inertia_kg_m2": 3.1e-8},
    "rotor_acceleration_torque": {"rotor_inertia_kg_m2": 4.4e-8},
    "attitude_filter_lean": {"strength": 1.0},
    "rotor_drag": {"drag_n_s_m": 0.0052},
}
IN_THE_RATES = tuple(
    name for name in UNLIKE_THE_PLANT if name not in ("attitude_filter_lean", "rotor_drag")
)


def model_file(folder, craft, effects):
    terms = tuple(
        EffectTerm(name, {key: Estimate(value) for key, value in values.items()})
        for name, values in effects.items()
    )
    model = msgspec.structs.replace(vehicle_model(load_vehicle(craft)), effects=terms)
    path = folder / f"{craft}_{len(terms)}.json"
    save_model(model, path)
    return str(path)


@pytest.mark.parametrize("craft", CRAFTS)
@pytest.mark.parametrize("plant", ["faithful", "reduced", "model"])
def test_what_the_model_says_acts_once_and_with_its_size(tmp_path, craft, plant):
    path = model_file(tmp_path, craft, UNLIKE_THE_PLANT)
    found = present_effects(StandInSettings(plant=plant, craft=path))
    assert found == {
        name: pytest.approx(values, rel=1e-6) for name, values in UNLIKE_THE_PLANT.items()
    }


@pytest.mark.parametrize("craft", CRAFTS)
@pytest.mark.parametrize("name", UNLIKE_THE_PLANT)
def test_one_effect_of_the_model_replaces_the_plants_and_leaves_the_others(tmp_path, craft, name):
    path = model_file(tmp_path, craft, {name: UNLIKE_THE_PLANT[name]})
    plain = present_effects(StandInSettings(craft=craft))
    expected = {**plain, name: pytest.approx(UNLIKE_THE_PLANT[name], rel=1e-6)}
    assert present_effects(StandInSettings(craft=path)) == expected


@pytest.mark.parametrize("delay_s", [0.0, 0.0003, 0.0025, 0.02])
@pytest.mark.parametrize("craft", CRAFTS)
def test_any_delay_of_the_model_is_the_whole_delay(tmp_path, craft, delay_s):
    path = model_file(tmp_path, craft, {"dead_time": {"delay_s": delay_s}})
    found = present_effects(StandInSettings(craft=path)).get("dead_time", {"delay_s": 0.0})
    assert found["delay_s"] == pytest.approx(delay_s, abs=2e-9)
    flown = craft_after(3.0, craft=path, program="hover", truth=True)
    settings = flown._parameters[0]
    lag_s = float(settings["dlpf_s"][0])
    ages = flown.truth()["sensor_age_s"][500:]
    assert ages + lag_s == pytest.approx(delay_s, abs=1e-8)


@pytest.mark.parametrize("craft", CRAFTS)
def test_a_low_pass_of_the_model_is_the_whole_lag_of_the_gyro(tmp_path, craft):
    path = model_file(tmp_path, craft, {"gyro_low_pass": {"bandwidth_hz": 40.0}})
    found = present_effects(StandInSettings(craft=path))
    assert found["gyro_low_pass"]["bandwidth_hz"] == pytest.approx(40.0)
    assert "dead_time" not in found


def test_what_the_plant_adds_is_told(tmp_path):
    path = model_file(tmp_path, "crazyflie1", {"dead_time": {"delay_s": 0.004}})
    told = StandIn(StandInSettings(craft=path)).added_by_plant
    assert told.startswith("not in the model, added by the plant: ")
    for name in ("battery_reading_lag", "supply_sag resistance_ohm 0.08 ohm", "vibration"):
        assert name in told
    assert "dead_time" not in told
    hidden = {"rotor_drag": {"drag_n_s_m": 0.01}}
    assert StandIn(StandInSettings(craft=path, effects=hidden)).added_by_plant == told


@pytest.mark.parametrize("plant", ["model", "reduced"])
def test_the_models_own_plant_adds_nothing(tmp_path, plant):
    path = model_file(tmp_path, "crazyflie21", {})
    settings = StandInSettings(plant=plant, craft=path)
    assert present_effects(settings) == {}
    assert StandIn(settings).added_by_plant == ""
    assert StandIn(StandInSettings()).added_by_plant == ""


def test_a_profile_is_no_model():
    with pytest.raises(ValueError, match='plant = "model": craft crazyflie1 is a profile'):
        StandIn(StandInSettings(plant="model"))


def test_one_delay_is_not_said_twice(tmp_path):
    path = model_file(tmp_path, "crazyflie1", {"dead_time": {"delay_s": 0.004}})
    settings = msgspec.convert({"craft": path, "sensor": {"delay_s": 0.016}}, StandInSettings)
    with pytest.raises(ValueError, match="the model has dead_time"):
        StandIn(settings)


@pytest.mark.parametrize("craft", CRAFTS)
@pytest.mark.parametrize("seed", range(len(HIDEABLE)))
def test_what_is_hidden_comes_on_top_of_the_model(tmp_path, craft, seed, capsys):
    path = model_file(tmp_path, craft, UNLIKE_THE_PLANT)
    plain, sealed = tmp_path / "craft.toml", tmp_path / "sealed.toml"
    plain.write_text(f'craft = "{path}"\n')
    status = main(["--settings", str(plain), "--seed", str(seed), "-o", str(sealed)])
    name = HIDEABLE[seed]
    if name in UNLIKE_THE_PLANT:
        assert status == 1
        assert "a model without it" in capsys.readouterr().err
        return
    assert status == 0
    found = present_effects(load_settings(sealed))
    assert found.pop(name)
    assert found == present_effects(load_settings(plain))


def identified(craft, plant, seed, fitted_along, vehicle, **more):
    """A model and {name: (value, standard error)} from a flight of half a minute, or of a whole
    one, which it takes to tell the sign of every effect."""
    samples, _ = recorded(
        60.0 if fitted_along else 30.0, craft=craft, plant=plant, seed=seed, truth=False, **more
    )
    before = vehicle_model(load_vehicle(vehicle))
    model = identify_body(
        runs_of(samples, f"flight {seed}"), [], before, load_vehicle(vehicle), fitted_along
    ).documented()
    told = model.fit["body"]["estimates"]
    found = dict(zip(told["names"], zip(told["values"], told["stderr"], strict=True), strict=True))
    for term in model.effects:
        for key, one in term.parameters.items():
            if one.stderr is not None:
                found[f"{term.name}.{key}"] = (one.value, one.stderr)
    return model, found


@functools.cache
def identified_at_first(craft, plant, fitted_along):
    return identified(craft, plant, 1, fitted_along, craft)


def assert_same_within_errors(again, first):
    assert set(again) == set(first)
    for name, (value, error) in again.items():
        before, error_before = first[name]
        assert abs(value - before) < 4.0 * math.hypot(error, error_before), name


@pytest.mark.parametrize(
    ("craft", "plant", "effects"),
    [("crazyflie21", "reduced", ()), ("crazyflie1", "faithful", IN_THE_RATES)],
)
def test_fit_fly_and_fit_again_gives_the_same_constants(tmp_path, craft, plant, effects):
    model, first = identified_at_first(craft, plant, effects)
    assert {"c0", "c1", "c2", "thrust_per_mass"} <= set(first)
    save_model(model, tmp_path / "body.json")
    _, again = identified(str(tmp_path / "body.json"), plant, 2, effects, craft)
    assert_same_within_errors(again, first)


def test_an_effect_hidden_on_top_of_a_fitted_model_is_found_beside_its_constants(tmp_path):
    model, first = identified_at_first("crazyflie1", "faithful", IN_THE_RATES)
    save_model(model, tmp_path / "body.json")
    assert load_model(tmp_path / "body.json").effects == model.effects
    hidden = {"yaw_damping": {"damping_n_m_s": 4e-6}}
    effects = (*IN_THE_RATES, "yaw_damping")
    _, again = identified(
        str(tmp_path / "body.json"), "faithful", 3, effects, "crazyflie1", effects=hidden
    )
    value, error = again.pop("yaw_damping.damping_n_m_s")
    assert abs(value - 4e-6) < 4.0 * error
    assert error < 1e-6
    assert_same_within_errors(again, first)
