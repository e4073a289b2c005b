"""Names of what can be hidden in a craft, and the parameters behind each.

Every name of the design, and four that no list contains. Nothing of this reaches a packet or
a recording's metadata.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from firmware_sim.layout import ALL_STATES, PASS_NS

G = 9.80665
MOST_DELAY_S = 0.04
_Apply = Callable[[Any, dict[str, float]], None]


@dataclass(frozen=True, slots=True)
class Effect:
    """parameters: name -> (default, unit). listed: whether the design names the effect.

    limits: parameter -> (least, most) that the plant can fly; without them any finite number.
    """

    parameters: dict[str, tuple[float, str]]
    apply: _Apply
    listed: bool = True
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)


def apply_effects(p: Any, effects: dict[str, dict[str, float]]) -> None:
    """Put effects into a PARAMETERS record.

    Raises ValueError for a name or a parameter that does not exist, or a value out of limits.
    """
    for name, given in effects.items():
        if name not in EFFECTS:
            raise ValueError(f"effect {name!r}: there are {', '.join(sorted(EFFECTS))}")
        effect = EFFECTS[name]
        unknown = set(given) - set(effect.parameters)
        if unknown:
            raise ValueError(
                f"effect {name}: no parameter {', '.join(sorted(unknown))};"
                f" there are {', '.join(effect.parameters)}"
            )
        values = {key: given.get(key, default) for key, (default, _) in effect.parameters.items()}
        for key, value in values.items():
            low, high = effect.limits.get(key, (-math.inf, math.inf))
            if not (low <= value <= high and math.isfinite(value)):
                raise ValueError(
                    f"effect {name}: {key} is {value}, must be finite and in [{low:g}, {high:g}]"
                )
            if key == "rotor" and value != int(value):
                raise ValueError(f"effect {name}: rotor is {value}, must be 1, 2, 3 or 4")
        effect.apply(p, values)


def _set(**fields: str) -> _Apply:
    """An effect whose parameters are fields of the record: field=parameter."""

    def apply(p: Any, values: dict[str, float]) -> None:
        for name, parameter in fields.items():
            p[name] = values[parameter]

    return apply


def _add_dead_time(p: Any, values: dict[str, float]) -> None:
    delay_ns = round(values["delay_s"] * 1e9)
    p["pipeline_ns"] += delay_ns
    if p["dlpf_s"][0] == 0:  # the ideal sensor samples so that the loop need not wait
        p["sensor_phase_ns"] = -int(p["pipeline_ns"]) % PASS_NS


def _gyro_low_pass(p: Any, values: dict[str, float]) -> None:
    if values["bandwidth_hz"] > 0:
        p["gyro_lag"] = 1 / (2 * math.pi * values["bandwidth_hz"])
        p["states"] = ALL_STATES


def _rotor_inertia(p: Any, values: dict[str, float]) -> None:
    p["rotor_inertia_gyro"] = p["rotor_inertia_yaw"] = values["rotor_inertia_kg_m2"]


def _mismatch(p: Any, values: dict[str, float]) -> None:
    p["strength"][int(values["rotor"]) - 1] = 1.0 + values["excess"]


def _mounting(p: Any, values: dict[str, float]) -> None:
    roll, pitch, yaw = (math.radians(values[k]) for k in ("roll_deg", "pitch_deg", "yaw_deg"))
    if not (roll or pitch or yaw):
        return
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    p["mounting"] = (about_z @ about_y @ about_x).ravel()
    p["rotated"] = 1


def _lever(p: Any, values: dict[str, float]) -> None:
    p["lever"] = values["x_m"], values["y_m"], values["z_m"]
    p["levered"] = int(any(values.values()))


def _gyro_bias(p: Any, values: dict[str, float]) -> None:
    p["gyro_bias"] += np.radians([values["x_dps"], values["y_dps"], values["z_dps"]])


def _accel_bias(p: Any, values: dict[str, float]) -> None:
    p["accel_bias"] += np.multiply([values["x_g"], values["y_g"], values["z_g"]], G)


def _inflow(p: Any, values: dict[str, float]) -> None:
    p["climb_inflow"] = values["loss_g_per_m_s"] * G


def _lean(p: Any, values: dict[str, float]) -> None:
    if values["strength"] > 0:
        p["ideal_attitude"] = 0


def _slung_load(p: Any, values: dict[str, float]) -> None:
    p["load_mass"], p["load_length"] = values["mass_kg"], values["length_m"]
    if values["mass_kg"] > 0:
        p["states"] = ALL_STATES


def _cracked_arm(p: Any, values: dict[str, float]) -> None:
    p["arm_hz"], p["arm_gain"] = values["frequency_hz"], values["gain"]
    p["arm_damping"], p["arm_rotor"] = values["damping"], int(values["rotor"]) - 1
    if values["gain"] != 0:
        p["states"] = ALL_STATES


def _bent_propeller(p: Any, values: dict[str, float]) -> None:
    p["bent_torque"] = values["torque_n_m"] / 250.0**2
    p["bent_rotor"] = int(values["rotor"]) - 1
    if values["torque_n_m"] != 0:
        p["states"] = ALL_STATES


def _resistance(p: Any, values: dict[str, float]) -> None:
    p["supply_ohm"] += values["resistance_ohm"]


def _reading_lag(p: Any, values: dict[str, float]) -> None:
    p["reading_lag"] = values["time_constant_s"]


_NMS = "N m s"
_POSITIVE = (0.0, math.inf)
_INERTIA = {"rotor_inertia_kg_m2": _POSITIVE}
_ROTOR = (1.0, 4.0)
EFFECTS: dict[str, Effect] = {
    "dead_time": Effect(
        {"delay_s": (0.004, "s")}, _add_dead_time, limits={"delay_s": (0.0, MOST_DELAY_S)}
    ),
    "gyro_low_pass": Effect(
        {"bandwidth_hz": (30.0, "Hz")}, _gyro_low_pass, limits={"bandwidth_hz": (0.0, 500.0)}
    ),
    # One inertia, both torques: what a craft has. The two names below are for models.
    "rotor_inertia": Effect(
        {"rotor_inertia_kg_m2": (5e-8, "kg m^2")}, _rotor_inertia, False, _INERTIA
    ),
    "rotor_gyroscopic_torque": Effect(
        {"rotor_inertia_kg_m2": (5e-8, "kg m^2")},
        _set(rotor_inertia_gyro="rotor_inertia_kg_m2"),
        limits=_INERTIA,
    ),
    "rotor_acceleration_torque": Effect(
        {"rotor_inertia_kg_m2": (5e-8, "kg m^2")},
        _set(rotor_inertia_yaw="rotor_inertia_kg_m2"),
        limits=_INERTIA,
    ),
    "inertia_coupling": Effect({"fraction": (1.0, "")}, _set(coupling="fraction")),
    "rate_damping": Effect({"damping_n_m_s": (1e-5, _NMS)}, _set(rate_damping="damping_n_m_s")),
    "quadratic_rate_damping": Effect(
        {"damping_n_m_s2": (1.5e-5, "N m s^2")}, _set(quadratic_damping="damping_n_m_s2")
    ),
    "yaw_damping": Effect({"damping_n_m_s": (4e-6, _NMS)}, _set(yaw_damping="damping_n_m_s")),
    "centre_of_gravity_offset": Effect(
        {"x_m": (0.0, "m"), "y_m": (0.0, "m")}, _set(gravity_x="x_m", gravity_y="y_m")
    ),
    "rotor_mismatch": Effect(
        {"rotor": (1.0, ""), "excess": (0.05, "")},
        _mismatch,
        limits={"rotor": _ROTOR, "excess": (-1.0, 1.0)},
    ),
    "motor_dead_voltage": Effect(
        {"voltage_mv": (200.0, "mV")}, _set(dead_mv="voltage_mv"), limits={"voltage_mv": _POSITIVE}
    ),
    "motor_braking_asymmetry": Effect(
        {"factor": (0.6, "")}, _set(braking="factor"), limits={"factor": (0.05, 5.0)}
    ),
    "supply_sag": Effect(
        {"resistance_ohm": (0.15, "ohm")}, _resistance, limits={"resistance_ohm": _POSITIVE}
    ),
    "battery_reading_lag": Effect(
        {"time_constant_s": (0.155, "s")}, _reading_lag, limits={"time_constant_s": _POSITIVE}
    ),
    "gyro_bias": Effect(
        {"x_dps": (0.0, "deg/s"), "y_dps": (0.0, "deg/s"), "z_dps": (0.0, "deg/s")}, _gyro_bias
    ),
    "accelerometer_bias": Effect(
        {"x_g": (0.0, "g"), "y_g": (0.0, "g"), "z_g": (0.0, "g")}, _accel_bias
    ),
    "imu_misalignment": Effect(
        {"roll_deg": (0.0, "deg"), "pitch_deg": (0.0, "deg"), "yaw_deg": (0.0, "deg")}, _mounting
    ),
    "rotor_drag": Effect({"drag_n_s_m": (0.008, "N s/m")}, _set(rotor_drag="drag_n_s_m")),
    "velocity_moment": Effect(
        {"moment": (10.0, "rad/s^2 per m/s")}, _set(velocity_moment="moment")
    ),
    "climb_inflow": Effect({"loss_g_per_m_s": (0.03, "g per m/s")}, _inflow),
    "imu_lever_arm": Effect({"x_m": (0.0, "m"), "y_m": (0.0, "m"), "z_m": (0.0, "m")}, _lever),
    "ground_effect": Effect(
        {"height_m": (0.08, "m"), "gain": (0.25, "")},
        _set(ground_height="height_m", ground_gain="gain"),
        limits={"height_m": (0.001, math.inf), "gain": (-0.9, 10.0)},
    ),
    "attitude_filter_lean": Effect({"strength": (1.0, "")}, _lean, limits={"strength": (0.0, 1.0)}),
    "slung_load": Effect(
        {"mass_kg": (0.002, "kg"), "length_m": (0.3, "m")},
        _slung_load,
        False,
        {"mass_kg": (0.0, 0.02), "length_m": (0.02, 10.0)},
    ),
    "cracked_arm": Effect(
        {
            "rotor": (1.0, ""),
            "frequency_hz": (35.0, "Hz"),
            "gain": (0.4, ""),
            "damping": (0.05, ""),
        },
        _cracked_arm,
        False,
        {"rotor": _ROTOR, "frequency_hz": (0.1, 250.0), "damping": (0.0, 1.0)},
    ),
    "bent_propeller": Effect(
        {"rotor": (1.0, ""), "torque_n_m": (5e-5, "N m")}, _bent_propeller, False, {"rotor": _ROTOR}
    ),
    "side_gust": Effect(
        {
            "frequency_hz": (0.7, "Hz"),
            "force_n": (0.01, "N"),
            "moment_n_m": (1e-5, "N m"),
        },
        _set(gust_hz="frequency_hz", gust_force="force_n", gust_moment="moment_n_m"),
        False,
    ),
}
