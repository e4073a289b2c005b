"""Flights of the reduced stand-in with one effect at medium size, and the model that has it."""

import msgspec
from stand_in_flights import CARRYING_GAINS, recorded, truth_of

from groundstation.dynamics.model import EffectTerm, Estimate, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.runs import runs_of

BASE = vehicle_model(BUILT_IN["crazyflie1"])
MEDIUM = {
    "dead_time": {"delay_s": 0.0057},
    "gyro_low_pass": {"bandwidth_hz": 25.0},
    "rotor_gyroscopic_torque": {"rotor_inertia_kg_m2": 1.5e-7},
    "rotor_acceleration_torque": {"rotor_inertia_kg_m2": 8e-8},
    "inertia_coupling": {"fraction": 1.0},
    "rate_damping": {"damping_n_m_s": 2e-5},
    "quadratic_rate_damping": {"damping_n_m_s2": 4e-5},
    "centre_of_gravity_offset": {"x_m": 1e-3, "y_m": -0.7e-3},
    "rotor_mismatch": {"rotor": 2, "excess": -0.05},
    "motor_dead_voltage": {"voltage_mv": 250.0},
    "motor_braking_asymmetry": {"factor": 0.6},
    "supply_sag": {"resistance_ohm": 0.2},
    "battery_reading_lag": {"time_constant_s": 0.4},
    "gyro_bias": {"x_dps": 1.5, "y_dps": -1.0, "z_dps": 2.0},
    "accelerometer_bias": {"x_g": 0.04, "y_g": -0.03, "z_g": 0.05},
    "imu_misalignment": {"roll_deg": 3.0, "pitch_deg": -4.0, "yaw_deg": 5.0},
    "rotor_drag": {"drag_n_s_m": 0.012},
    "velocity_moment": {"moment": 15.0},
    "yaw_damping": {"damping_n_m_s": 8e-6},
    "climb_inflow": {"loss_g_per_m_s": 0.04},
    "imu_lever_arm": {"x_m": 0.004, "y_m": -0.003, "z_m": 0.005},
    "ground_effect": {"height_m": 0.1, "gain": 0.3},
    "attitude_filter_lean": {"strength": 1.0},
    "mass_change": {"percent": 12.0},
}


def affected(name, parameters=None):
    """The base model with one effect."""
    values = MEDIUM[name] if parameters is None else parameters
    term = EffectTerm(name, {key: Estimate(float(value)) for key, value in values.items()})
    return msgspec.structs.replace(BASE, effects=(term,))


def flown(seconds, seed, name=None, **settings):
    """(run, truth) of one flight, with the effect at medium size if one is named."""
    effects = {} if name is None else {name: MEDIUM[name]}
    chosen = {"plant": "reduced", "gains": CARRYING_GAINS, "effects": effects, **settings}
    samples, truth = recorded(seconds, seed=seed, **chosen)
    (run,) = runs_of(samples)
    return run, truth_of(samples, truth)
