"""The list of effects: complete, consistent, and in the vocabulary of the stand-in."""

import pytest

from firmware_sim.effects.catalogue import EFFECTS as STAND_IN
from groundstation.dynamics.effect import Role
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.errors import BadInputError


def test_the_list_is_the_stand_ins_with_its_parameters_units_and_defaults():
    """What a firmware does to its readings is no effect to be hidden there: it runs in the loop.
    Of rotor speeds its telemetry has none."""
    theirs = {name: effect.parameters for name, effect in STAND_IN.items() if effect.listed}
    ours = {
        effect.name: {p.name: (p.default, p.unit) for p in effect.parameters}
        for effect in EFFECTS.values()
        if effect.role not in (Role.ON_BOARD, Role.WITH_BASE)
    }
    assert ours == theirs


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda effect: effect.name)
def test_an_effect_says_what_it_is_and_what_it_is_confused_with(effect):
    assert effect.adds
    assert effect.signature
    assert effect.excited_by
    assert effect.channels
    assert effect.name not in {one.other for one in effect.confused_with}
    assert {one.other for one in effect.confused_with} <= set(EFFECTS)
    assert all(one.manoeuvre for one in effect.confused_with)
    assert all(p.low < p.high for p in effect.parameters)
    assert effect.plausible({p.name: p.default for p in effect.parameters})


SIZES = {
    "dead_time": ("delay_s", 1e-3, 12e-3),
    "gyro_low_pass": ("bandwidth_hz", 12, 60),
    "rotor_gyroscopic_torque": ("rotor_inertia_kg_m2", 2e-8, 1.5e-7),
    "rotor_acceleration_torque": ("rotor_inertia_kg_m2", 2e-8, 1.5e-7),
    "rate_damping": ("damping_n_m_s", 3e-6, 3e-5),
    "quadratic_rate_damping": ("damping_n_m_s2", 5e-6, 4e-5),
    "rotor_mismatch": ("excess", -0.1, 0.1),
    "motor_dead_voltage": ("voltage_mv", 100, 350),
    "motor_braking_asymmetry": ("factor", 0.4, 0.9),
    "motor_coasting": ("share", 0.2, 1.0),
    "supply_sag": ("resistance_ohm", 0.05, 0.35),
    "battery_reading_lag": ("time_constant_s", 0.15, 0.6),
    "gyro_bias": ("x_dps", -3, 3),
    "accelerometer_bias": ("z_g", -0.08, 0.08),
    "imu_misalignment": ("yaw_deg", -7, 7),
    "rotor_drag": ("drag_n_s_m", 0.003, 0.02),
    "velocity_moment": ("moment", -30, 30),
    "yaw_damping": ("damping_n_m_s", 1e-6, 1e-5),
    "climb_inflow": ("loss_g_per_m_s", 0.01, 0.05),
    "imu_lever_arm": ("x_m", -0.006, 0.006),
    "ground_effect": ("height_m", 0.03, 0.15),
}
"""What a craft may have: the sizes that a search must be able to name."""


@pytest.mark.parametrize("name", SIZES)
def test_every_size_a_craft_may_have_is_plausible_and_another_sign_is_not(name):
    parameter, low, high = SIZES[name]
    effect = EFFECTS[name]
    assert effect.plausible({parameter: low})
    assert effect.plausible({parameter: high})
    if low > 0:
        assert not effect.plausible({parameter: -low})


def test_a_size_beyond_its_range_is_plausible_as_far_as_nobody_knows_it_better():
    low = EFFECTS["ground_effect"]  # of a height that is off by centimetres
    assert low.plausible({"height_m": 0.045, "gain": 0.08})
    assert not low.plausible({"height_m": 0.045, "gain": 0.03})
    assert not low.plausible({"height_m": 0.16, "gain": 0.08})


def test_absent_means_the_value_that_changes_nothing():
    assert EFFECTS["motor_braking_asymmetry"].absent({"factor": 1.0})
    assert not EFFECTS["motor_braking_asymmetry"].absent({"factor": 0.0})
    assert EFFECTS["rotor_mismatch"].absent({"rotor": 3, "excess": 0.0})
    assert EFFECTS["ground_effect"].absent({"height_m": 0.1, "gain": 0.0})
    assert not EFFECTS["dead_time"].absent({})


def test_a_parameter_that_does_not_exist_is_refused_with_those_that_do():
    with pytest.raises(BadInputError, match="no parameter 'delay'; there are delay_s"):
        EFFECTS["dead_time"].values({"delay": 0.1})


def test_a_value_that_is_no_number_is_refused():
    with pytest.raises(BadInputError, match="must be finite"):
        EFFECTS["dead_time"].values({"delay_s": float("nan")})


@pytest.mark.parametrize(
    "effect", [one for one in EFFECTS.values() if one.on_board], ids=lambda effect: effect.name
)
def test_a_vehicle_says_the_size_of_what_runs_on_board(effect):
    (size,) = effect.parameters
    assert getattr(BUILT_IN["crazyflie21"], effect.on_board) == size.default
    assert getattr(BUILT_IN["crazyflie1"], effect.on_board) == 0.0
