"""What is hidden: names, sizes and signs by seed (the acceptance list's ranges)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from firmware_sim.effects.catalogue import EFFECTS

Draw = Callable[[np.random.Generator], dict[str, float]]

LISTED = tuple(name for name, effect in EFFECTS.items() if effect.listed)
"""The 23 names of the design."""
OUTSIDE = ("slung_load", "cracked_arm", "bent_propeller", "side_gust")
ROTOR_TORQUES = ("rotor_gyroscopic_torque", "rotor_acceleration_torque")
ALWAYS_FAITHFUL = (
    "battery_reading_lag",
    "attitude_filter_lean",
    "dead_time",
    "inertia_coupling",
    *ROTOR_TORQUES,
    "supply_sag",
)
CONFUSABLE = (
    {"motor_dead_voltage", "supply_sag"},
    {"dead_time", "gyro_low_pass"},
    {"centre_of_gravity_offset", "rotor_mismatch"},
)
"""Pairs that one flight may not separate: right when both are listed and the manoeuvre settles."""

CHANNELS: dict[str, tuple[str, ...]] = {
    "dead_time": ("gyro", "roll", "pitch", "yaw", "accelerometer"),
    "gyro_low_pass": ("gyro", "roll", "pitch", "yaw"),
    "rotor_gyroscopic_torque": ("gyro x", "gyro y", "roll", "pitch"),
    "rotor_acceleration_torque": ("gyro z", "yaw"),
    "inertia_coupling": ("gyro x", "gyro y", "roll", "pitch"),
    "rate_damping": ("gyro x", "gyro y", "roll", "pitch"),
    "quadratic_rate_damping": ("gyro x", "gyro y", "roll", "pitch"),
    "yaw_damping": ("gyro z", "yaw"),
    "centre_of_gravity_offset": ("gyro x", "gyro y", "roll", "pitch"),
    "rotor_mismatch": ("gyro", "roll", "pitch", "yaw"),
    "motor_dead_voltage": ("gyro", "accelerometer z", "roll", "pitch", "yaw"),
    "motor_braking_asymmetry": ("gyro", "accelerometer z", "roll", "pitch", "yaw"),
    "supply_sag": ("gyro", "accelerometer z", "roll", "pitch", "yaw"),
    "battery_reading_lag": ("gyro", "accelerometer z", "roll", "pitch", "yaw"),
    "gyro_bias": ("roll", "pitch", "yaw", "gyro"),
    "accelerometer_bias": ("accelerometer",),
    "imu_misalignment": ("gyro", "accelerometer", "roll", "pitch", "yaw"),
    "rotor_drag": ("accelerometer x", "accelerometer y"),
    "velocity_moment": ("gyro x", "gyro y", "roll", "pitch"),
    "climb_inflow": ("accelerometer z",),
    "imu_lever_arm": ("accelerometer",),
    "ground_effect": ("accelerometer z", "gyro", "roll", "pitch", "yaw"),
    "attitude_filter_lean": ("roll", "pitch", "yaw"),
    "slung_load": ("gyro x", "gyro y", "accelerometer", "roll", "pitch"),
    "cracked_arm": ("gyro", "accelerometer z", "roll", "pitch", "yaw"),
    "bent_propeller": ("gyro x", "gyro y", "roll", "pitch"),
    "side_gust": ("accelerometer y", "gyro x", "roll", "accelerometer x", "gyro y", "pitch"),
}
"""Channels (or their first word) in which each effect shows first: where ``where`` may point."""


_TILTING = {"high roll or pitch rate", "roll or pitch torque", "turning about several axes"}
_YAWING = {"high yaw rate", "after yaw commands", "turning about several axes"}
_ROTORS = {"rotor acceleration", "rotors slowing down", "thrust change"}
_THRUST = {"high thrust", "low thrust", "climb", "descent", "thrust change"}
_STEADY = {"whole flight", "hover"}
REGIMES: dict[str, set[str]] = {
    "dead_time": _TILTING | _YAWING | _ROTORS | _STEADY,
    "gyro_low_pass": _TILTING | _YAWING | _ROTORS | _STEADY,
    "rotor_gyroscopic_torque": _YAWING | _TILTING,  # a product of both
    "rotor_acceleration_torque": {*_YAWING, "rotor acceleration", "rotors slowing down"},
    "inertia_coupling": _YAWING | _TILTING,
    "rate_damping": _TILTING,
    "quadratic_rate_damping": _TILTING,
    "yaw_damping": _YAWING,
    "centre_of_gravity_offset": _STEADY | _THRUST,
    "rotor_mismatch": _STEADY | _THRUST,
    "motor_dead_voltage": {*_STEADY, *_THRUST, *_ROTORS, "saturation", "low battery"},
    "motor_braking_asymmetry": {*_ROTORS, *_TILTING, "after yaw commands", "low thrust"},
    "supply_sag": {*_STEADY, *_THRUST, *_ROTORS, "saturation", "low battery"},
    "battery_reading_lag": _THRUST | _ROTORS,
    "gyro_bias": _STEADY,
    "accelerometer_bias": _STEADY,
    "imu_misalignment": _STEADY | _TILTING | _YAWING | _THRUST,
    "rotor_drag": {"translation", "tilted"},
    "velocity_moment": {"translation", "tilted"},
    "climb_inflow": {"climb", "descent"},
    "imu_lever_arm": {*_TILTING, *_YAWING, "rotor acceleration"},
    "ground_effect": {"near ground"},
    "attitude_filter_lean": {*_STEADY, "translation", "tilted"},
}
"""Regimes of the report that each listed effect excites."""


def draw(name: str, generator: np.random.Generator) -> dict[str, float]:
    """Parameters of a hidden effect: log-uniform size in the acceptance's range, random sign."""
    return _DRAWS[name](generator)


def planted(name: str, values: dict[str, float], alone: bool) -> dict[str, dict[str, float]]:
    """The stand-in's settings for one hidden effect.

    A rotor's inertia makes two torques. Half of the cases hide what a craft has, both; ``alone``
    hides the named one only.
    """
    if name in ROTOR_TORQUES and not alone:
        return {"rotor_inertia": values}
    return {name: values}


def scaled(name: str, values: dict[str, float], factor: float) -> dict[str, float]:
    """The same effect ``factor`` times as large."""
    if name == "gyro_low_pass":
        return {"bandwidth_hz": values["bandwidth_hz"] / factor}
    if name == "motor_braking_asymmetry":
        return {"factor": 1.0 - factor * (1.0 - values["factor"])}
    if name == "attitude_filter_lean":
        return values
    fixed = ("rotor", "height_m") if name in ("ground_effect", "rotor_mismatch") else ()
    return {key: v if key in fixed else factor * v for key, v in values.items()}


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
