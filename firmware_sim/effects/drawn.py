"""Sizes and signs of hidden effects, drawn from the ranges that a craft may have."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from firmware_sim.effects.catalogue import EFFECTS

Draw = Callable[[np.random.Generator], dict[str, float]]


def draw(name: str, generator: np.random.Generator) -> dict[str, float]:
    """Parameters of an effect: log-uniform size, random sign or direction."""
    return _DRAWS[name](generator)


def _size(generator: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(generator.uniform(math.log(low), math.log(high))))


def _one(parameter: str, low: float, high: float) -> Draw:
    return lambda generator: {parameter: _size(generator, low, high)}


def _vector(low: float, high: float, *parameters: str) -> Draw:
    def drawn(generator: np.random.Generator) -> dict[str, float]:
        direction = generator.normal(size=len(parameters))
        vector = _size(generator, low, high) * direction / np.linalg.norm(direction)
        return dict(zip(parameters, vector.tolist(), strict=True))

    return drawn


def _mismatch(generator: np.random.Generator) -> dict[str, float]:
    sign = generator.choice((-1.0, 1.0))
    rotor = float(generator.integers(1, 5))
    return {"rotor": rotor, "excess": float(sign * _size(generator, 0.01, 0.1))}


def _defaults(name: str) -> Draw:
    return lambda generator: {key: value for key, (value, _) in EFFECTS[name].parameters.items()}


_DRAWS: dict[str, Draw] = {
    "dead_time": _one("delay_s", 1e-3, 12e-3),
    "gyro_low_pass": _one("bandwidth_hz", 12.0, 60.0),
    "rotor_gyroscopic_torque": _one("rotor_inertia_kg_m2", 2e-8, 1.5e-7),
    "rotor_acceleration_torque": _one("rotor_inertia_kg_m2", 2e-8, 1.5e-7),
    "inertia_coupling": _defaults("inertia_coupling"),
    "rate_damping": _one("damping_n_m_s", 3e-6, 3e-5),
    "quadratic_rate_damping": _one("damping_n_m_s2", 5e-6, 4e-5),
    "yaw_damping": _one("damping_n_m_s", 1e-6, 1e-5),
    "centre_of_gravity_offset": _vector(0.2e-3, 2e-3, "x_m", "y_m"),
    "rotor_mismatch": _mismatch,
    "motor_dead_voltage": _one("voltage_mv", 100.0, 350.0),
    "motor_braking_asymmetry": _one("factor", 0.4, 0.9),
    "supply_sag": _one("resistance_ohm", 0.05, 0.35),
    "battery_reading_lag": _one("time_constant_s", 0.15, 0.6),
    "gyro_bias": _vector(0.2, 3.0, "x_dps", "y_dps", "z_dps"),
    "accelerometer_bias": _vector(0.01, 0.08, "x_g", "y_g", "z_g"),
    "imu_misalignment": _vector(0.5, 7.0, "roll_deg", "pitch_deg", "yaw_deg"),
    "rotor_drag": _one("drag_n_s_m", 0.003, 0.02),
    "velocity_moment": _one("moment", 2.0, 30.0),
    "climb_inflow": _one("loss_g_per_m_s", 0.01, 0.05),
    "imu_lever_arm": _vector(1e-3, 6e-3, "x_m", "y_m", "z_m"),
    "ground_effect": lambda generator: {"height_m": _size(generator, 0.03, 0.15), "gain": 0.25},
    "attitude_filter_lean": _defaults("attitude_filter_lean"),
    "slung_load": lambda generator: {
        "mass_kg": _size(generator, 0.5e-3, 3e-3),
        "length_m": _size(generator, 0.15, 0.5),
    },
    "cracked_arm": lambda generator: {
        "rotor": float(generator.integers(1, 5)),
        "frequency_hz": _size(generator, 15.0, 60.0),
        "gain": _size(generator, 0.1, 0.5),
        "damping": 0.05,
    },
    "bent_propeller": lambda generator: {
        "rotor": float(generator.integers(1, 5)),
        "torque_n_m": _size(generator, 2e-5, 2e-4),
    },
    "side_gust": lambda generator: {
        "frequency_hz": _size(generator, 0.3, 2.0),
        "force_n": _size(generator, 0.004, 0.02),
        "moment_n_m": _size(generator, 4e-6, 4e-5),
    },
}
