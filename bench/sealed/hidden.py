"""What is hidden: names, and where each one shows. Sizes: ``firmware_sim.effects.catalogue``."""

from __future__ import annotations

from firmware_sim.effects.catalogue import EFFECTS

LATER = ("slung_load", "motor_coasting")
"""Listed since results were kept: last, and in no mixture, so old cases stay what they were."""
UNBOUNDED = ("wind", "propeller_imbalance", "position_aided_lean")
"""Listed, but no bound says how well it can be told: the first two no column of a fit shows, the
last acts on what is reported alone."""
MIXED = tuple(
    name
    for name, effect in EFFECTS.items()
    if effect.listed and name not in ("mass_change", *LATER, *UNBOUNDED)
)
LISTED = (*MIXED, *LATER)
"""The names of the design; a changed mass is told by what becomes of the base constants."""
OUTSIDE = ("cracked_arm", "bent_propeller", "side_gust")
"""No list has them; of a bent propeller the couple has a name, ``propeller_imbalance``."""
ROTOR_TORQUES = ("rotor_gyroscopic_torque", "rotor_acceleration_torque")
ALWAYS_FAITHFUL = (
    "battery_reading_lag",
    "attitude_filter_lean",
    "dead_time",
    "inertia_coupling",
    *ROTOR_TORQUES,
    "supply_sag",
)

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
    "motor_coasting": ("gyro", "accelerometer z", "roll", "pitch", "yaw"),
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
    "motor_coasting": {*_ROTORS, *_TILTING, "after yaw commands", "low thrust"},
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
    "slung_load": {*_STEADY, *_TILTING, *_THRUST, "translation", "tilted"},
}
"""Regimes of the report that each listed effect excites."""


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
    fixed: tuple[str, ...] = ()
    if name in ("ground_effect", "rotor_mismatch"):
        fixed = "rotor", "height_m"
    if name == "slung_load":
        fixed = "length_m", "damping_per_s", "below_m"
    if name == "velocity_moment":
        fixed = ("asymmetry",)
    return {key: v if key in fixed else factor * v for key, v in values.items()}
