"""Vehicle profiles."""

from __future__ import annotations

import math

import msgspec
import pytest

from groundstation.dynamics.vehicle import (
    BUILT_IN,
    THESIS_MOTOR,
    lever_arm_m,
    load_vehicle,
    rotor_positions_m,
)
from groundstation.errors import BadInputError


def as_toml(**changes) -> bytes:
    profile = msgspec.to_builtins(BUILT_IN["crazyflie1"])
    profile.update(changes)
    lines = []
    for key, value in profile.items():
        if isinstance(value, dict):
            lines.append(f"{key} = {{ {', '.join(f'{k} = {v}' for k, v in value.items())} }}")
        elif isinstance(value, str):
            lines.append(f'{key} = "{value}"')
        else:
            lines.append(f"{key} = {list(value) if isinstance(value, tuple) else value}")
    return "\n".join(lines).encode()


@pytest.mark.parametrize("speed", [50.0, 241.6, 350.0])
def test_armature_voltage_and_steady_speed_are_inverse(speed):
    assert THESIS_MOTOR.steady_rev_s(THESIS_MOTOR.armature_mv(speed)) == pytest.approx(speed)


def test_the_default_craft_has_a_plausible_agility():
    c0, c1, c2 = load_vehicle("crazyflie1").body_constants
    assert 0.0038 < c0 == c1 < 0.0054
    assert c2 == pytest.approx(0.0005)


def test_rotors_stand_where_the_frame_says():
    plus, x = load_vehicle("crazyflie1"), load_vehicle("crazyflie21")
    assert rotor_positions_m(plus) == ((0.045, 0), (0, -0.045), (-0.045, 0), (0, 0.045))
    lever = 0.046 / math.sqrt(2)
    assert lever_arm_m(x) == pytest.approx(lever)
    assert rotor_positions_m(x)[0] == pytest.approx((lever, -lever))
    assert rotor_positions_m(x)[2] == pytest.approx((-lever, lever))


def test_a_profile_can_be_a_toml_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(as_toml(name="mine", mass_kg=0.021))
    vehicle = load_vehicle(path)
    assert (vehicle.name, vehicle.mass_kg) == ("mine", 0.021)
    assert vehicle.motor == THESIS_MOTOR


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass_kg": -1.0}, "mass_kg is -1.0, must be positive"),
        ({"mass_kg": "heavy"}, r"mass_kg"),
        ({"wings": 2}, "wings"),
        ({"configuration": "y"}, "configuration"),
        ({"inertia_kg_m2": (1e-5, 1e-5, 4e-5)}, "not that of a body"),
        ({"inertia_kg_m2": (1e-5, 1e-5, 2.11e-5)}, "by 5.5%"),
        ({"gyro_filter_hz": -80.0}, "gyro_filter_hz is -80.0, must not be negative"),
        ({"base": "crazyflie9"}, "base is 'crazyflie9'; choose one of crazyflie1, crazyflie21"),
        ({"drag_n_m": 0.0}, "drag_n_m is 0.0, must be positive"),
        ({"rotor_inertia_kg_m2": -1e-8}, "rotor_inertia_kg_m2 is -1e-08, must not be negative"),
        ({"gains": {"'pid_rate.roll_kp'": "nan"}}, "pid_rate.roll_kp is nan, must be finite"),
    ],
)
def test_a_bad_profile_is_refused_with_the_key(tmp_path, changes, message):
    path = tmp_path / "bad.toml"
    path.write_bytes(as_toml(**changes))
    with pytest.raises(BadInputError, match=message):
        load_vehicle(path)


def test_an_unknown_profile_names_those_that_exist():
    with pytest.raises(BadInputError, match="crazyflie1, crazyflie21"):
        load_vehicle("crazyflie9")


def test_the_much_copied_inertia_is_taken_with_a_warning(tmp_path):
    path = tmp_path / "copied.toml"
    path.write_bytes(as_toml(inertia_kg_m2=(1.43e-5, 1.43e-5, 2.89e-5)))
    with pytest.warns(UserWarning, match=r"exceeds the sum of the others by 1\.0%"):
        assert load_vehicle(path).inertia_kg_m2[2] == 2.89e-5


def test_a_profile_can_say_only_what_differs_from_a_built_in_one(tmp_path):
    path = tmp_path / "deck.toml"
    path.write_text('base = "crazyflie21"\nname = "deck"\nmass_kg = 0.0347\n')
    deck, bare = load_vehicle(path), load_vehicle("crazyflie21")
    assert deck == msgspec.structs.replace(bare, name="deck", mass_kg=0.0347)
    path.write_text('base = "crazyflie21"\nmass_kg = 0.0347\n')
    with pytest.raises(BadInputError, match="needs a name of its own"):
        load_vehicle(path)


@pytest.mark.parametrize(
    ("name", "curve"),
    [
        ("crazyflie21", (-0.014831, 0.047245, -0.018474, 0.0059609)),
        ("crazyflie21plus", (-0.024765, 0.065238, -0.026793, 0.0067768)),
        ("crazyflie21upgrade", (0.0067281, 0.010116, 0.010263, 0.0028358)),
    ],
)
def test_a_brushed_craft_hovers_where_its_thrust_curve_says(name, curve):
    """Firmware of 2026: thrust of a motor in N from its voltage in V."""
    vehicle = load_vehicle(name)
    hover_rev_s = math.sqrt(9.80665 / (4 * vehicle.thrust_per_mass))
    volts = vehicle.motor.armature_mv(hover_rev_s) / 1e3
    thrust = sum(k * volts**power for power, k in enumerate(curve))
    assert thrust == pytest.approx(vehicle.mass_kg * 9.80665 / 4, rel=0.1)


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "crazyflie1"])
def test_todays_firmware_filters_its_sensors(name):
    vehicle = load_vehicle(name)
    assert (vehicle.gyro_filter_hz, vehicle.accelerometer_filter_hz) == (80.0, 30.0)
    assert load_vehicle("crazyflie1").gyro_filter_hz == 0.0
