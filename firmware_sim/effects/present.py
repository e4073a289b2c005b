"""What is truly in a craft, hidden or always there: the answer that a search is judged by."""

from __future__ import annotations

import math

import numpy as np

from firmware_sim.battery import ADC_FILTER, ADC_PASSES
from firmware_sim.effects.catalogue import G
from firmware_sim.layout import PASS_NS
from firmware_sim.physics import parameters
from firmware_sim.settings import StandInSettings

ADC_LAG_S = ADC_PASSES * PASS_NS * 1e-9 / ADC_FILTER
"""Time constant of the firmware's battery filter."""


def present_effects(settings: StandInSettings) -> dict[str, dict[str, float]]:
    """Every listed effect that the stand-in contains: name -> parameter -> true value.

    Parameters as in the catalogue. The delay of the faithful sensor is its mean: DLPF lag, pure
    delay, bus, and half a pass of waiting for the loop.
    """
    p = parameters(settings)[0]
    found: dict[str, dict[str, float]] = {}

    def add(name: str, **values: float) -> None:
        neutral = 1.0 if name == "motor_braking_asymmetry" else 0.0
        if any(value != neutral for value in values.values()):
            found[name] = values

    age_s = float(p["pipeline_ns"]) * 1e-9 + float(p["dlpf_s"][0])
    add("dead_time", delay_s=age_s + (0.5e-9 * PASS_NS if p["dlpf_s"][0] else 0.0))
    if p["gyro_lag"]:
        add("gyro_low_pass", bandwidth_hz=1 / (2 * math.pi * p["gyro_lag"]))
    add("rotor_gyroscopic_torque", rotor_inertia_kg_m2=p["rotor_inertia_gyro"])
    add("rotor_acceleration_torque", rotor_inertia_kg_m2=p["rotor_inertia_yaw"])
    add("inertia_coupling", fraction=p["coupling"])
    add("rate_damping", damping_n_m_s=p["rate_damping"])
    add("quadratic_rate_damping", damping_n_m_s2=p["quadratic_damping"])
    add("yaw_damping", damping_n_m_s=p["yaw_damping"])
    add("centre_of_gravity_offset", x_m=p["gravity_x"], y_m=p["gravity_y"])
    for rotor in np.flatnonzero(p["strength"] != 1.0):
        add("rotor_mismatch", rotor=rotor + 1.0, excess=p["strength"][rotor] - 1.0)
    add("motor_dead_voltage", voltage_mv=p["dead_mv"])
    add("motor_braking_asymmetry", factor=p["braking"])
    add("supply_sag", resistance_ohm=p["supply_ohm"])
    add("battery_reading_lag", time_constant_s=p["reading_lag"] + ADC_LAG_S * p["adc_filter"])
    x, y, z = np.degrees(p["gyro_bias"])
    add("gyro_bias", x_dps=x, y_dps=y, z_dps=z)
    x, y, z = p["accel_bias"] / G
    add("accelerometer_bias", x_g=x, y_g=y, z_g=z)
    if p["rotated"]:
        m = p["mounting"].reshape(3, 3)
        add(
            "imu_misalignment",
            roll_deg=math.degrees(math.atan2(m[2, 1], m[2, 2])),
            pitch_deg=math.degrees(-math.asin(m[2, 0])),
            yaw_deg=math.degrees(math.atan2(m[1, 0], m[0, 0])),
        )
    add("rotor_drag", drag_n_s_m=p["rotor_drag"])
    add("velocity_moment", moment=p["velocity_moment"])
    add("climb_inflow", loss_g_per_m_s=p["climb_inflow"] / G)
    x, y, z = p["lever"]
    add("imu_lever_arm", x_m=x, y_m=y, z_m=z)
    if p["ground_gain"]:
        add("ground_effect", height_m=p["ground_height"], gain=p["ground_gain"])
    add("attitude_filter_lean", strength=1.0 - p["ideal_attitude"])
    return {name: {key: float(v) for key, v in values.items()} for name, values in found.items()}
