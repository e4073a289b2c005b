"""From settings and a vehicle or model to the numbers that the kernels fly, and what is in them.

A fitted model knows ratios only. Its profile gives mass and arm; then, with rotor thrust
``k = mass x thrust_per_mass``, ``Ixx = k l / c0``, ``Iyy = k l / c1``, ``Izz`` keeps the
profile's ratio to ``Ixx + Iyy``, and the drag is ``b = c2 Izz``: a craft with exactly the
model's c0, c1, c2, thrust_per_mass and motors, and a plausible scale for everything physical.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_sim import today
from firmware_sim.effects.catalogue import EFFECTS as IMPLEMENTED
from firmware_sim.effects.catalogue import apply_effects, replace_effects
from firmware_sim.effects.own import apply_laws
from firmware_sim.layout import (
    ALL_STATES,
    CORE_STATES,
    FIRMWARE,
    PARAMETERS,
    PASS_NS,
    SENSOR_RING,
)
from firmware_sim.programme import load_programme
from firmware_sim.settings import Sensor, StandInSettings
from firmware_sim.supervisor import NOT_PASSED
from groundstation.dynamics.craft import Acting, find_effect
from groundstation.dynamics.effect import Role
from groundstation.dynamics.model import (
    EffectTerm,
    Estimate,
    Model,
    load_model,
    model_vehicle,
    rotor_motors,
)
from groundstation.dynamics.registry import EFFECTS as LISTED
from groundstation.dynamics.vehicle import BUILT_IN, Vehicle, load_vehicle, rotor_positions_m

G = 9.80665
DLPF: dict[int, tuple[tuple[float, float], tuple[float, float]]] = {
    1: ((188.0, 1.9e-3), (184.0, 2.0e-3)),
    2: ((98.0, 2.8e-3), (94.0, 3.0e-3)),
    3: ((42.0, 4.8e-3), (44.0, 4.9e-3)),
    4: ((20.0, 8.3e-3), (21.0, 8.5e-3)),
    5: ((10.0, 13.4e-3), (10.0, 13.8e-3)),
    6: ((5.0, 18.6e-3), (5.0, 19.0e-3)),
}
"""DLPF_CFG -> (bandwidth in Hz, delay in s) of the gyro and of the accelerometer."""
BUS_S = 0.4e-3
KNOWN_VARIANCE, UNKNOWN_VARIANCE = 1e-5, 100.0
"""Of position (m^2) and velocity (m^2/s^2)."""
FLOW_NOISE_COUNTS = 1.0
"""Of a Flow deck over a floor that it sees well: half of what the firmware expects."""
THESIS_GAINS = {
    "pid_rate.roll_kp": 12.0,
    "pid_rate.pitch_kp": 12.0,
    "pid_attitude.roll_kp": 2.5,
    "pid_attitude.pitch_kp": 2.5,
    "pid_attitude.roll_ki": 1.0,
    "pid_attitude.pitch_ki": 1.0,
}
"""The thesis's craft is three times as agile as stock gains allow: with them it oscillates."""

STOCK = {
    "rate_kp": (70.0, 70.0, 50.0),
    "rate_ki": (0.0, 0.0, 25.0),
    "rate_kd": (0.0, 0.0, 0.0),
    "angle_kp": (3.5, 3.5, 0.0),
    "angle_ki": (2.0, 2.0, 0.0),
    "angle_kd": (0.0, 0.0, 0.0),
}


def craft_of(settings: StandInSettings) -> tuple[Vehicle, Model | None]:
    """The vehicle that flies and the model it came from, if it came from one."""
    if settings.craft in BUILT_IN or Path(settings.craft).suffix == ".toml":
        if settings.plant == "model":
            raise ValueError(
                f'plant = "model": craft {settings.craft} is a profile and no fitted model; give a'
                ' model file, or say plant = "reduced"'
            )
        return load_vehicle(settings.craft), None
    model = load_model(settings.craft)
    vehicle = realize(model)
    if settings.craft == "thesis":
        vehicle = msgspec.structs.replace(vehicle, gains={**vehicle.gains, **THESIS_GAINS})
    return vehicle, model


def realize(model: Model) -> Vehicle:
    """A physical craft with exactly the model's constants (see the module's text)."""
    profile = model_vehicle(model)
    if model.body is None:
        raise ValueError("the model has no body constants: only an ARX model cannot be flown")
    body = model.body
    thrust = profile.mass_kg * body.thrust_per_mass
    lever = max(abs(x) for x, _ in rotor_positions_m(profile))
    ixx, iyy = thrust * lever / body.c0, thrust * lever / body.c1
    px, py, pz = profile.inertia_kg_m2
    izz = pz / (px + py) * (ixx + iyy)
    return msgspec.structs.replace(
        profile,
        inertia_kg_m2=(ixx, iyy, izz),
        motor=model.motor,
        thrust_n=thrust,
        drag_n_m=body.c2 * izz,
    )


def parameters(settings: StandInSettings) -> NDArray[np.void]:
    """The PARAMETERS record of a stand-in, shape (1,)."""
    vehicle, model = craft_of(settings)
    record = np.zeros(1, PARAMETERS)
    p = record[0]
    is_today = firmware_of(settings, vehicle) == "2.x"
    _body(p, vehicle)
    _power(p, vehicle, settings)
    if any(s.kind == "bench" for s in load_programme(settings.program).segment):
        p["states"] = ALL_STATES
    p["longest_step"] = PASS_NS * 1e-9 / settings.substeps
    p["hold_height"] = 0.8
    p["gate_glitches"] = settings.gate_glitches
    p["resume_ns"] = round(settings.resume_s * 1e9)
    p["land_when_low"] = settings.land_when_low
    p["flow_aided"] = settings.flow_deck
    p["flow_noise"] = settings.sensor_noise * FLOW_NOISE_COUNTS
    sticks_s, stuck_m = settings.range_sticks_s, settings.range_stuck_m
    p["range_sticks_ns"] = -1 if sticks_s is None else round(sticks_s * 1e9)
    p["range_stuck_m"] = -1.0 if stuck_m is None else stuck_m
    draws = np.random.default_rng((settings.seed, 1))
    phase, ppm = draws.uniform(0, PASS_NS * 1e-9), draws.normal(0, 10.0)
    sensor = settings.sensor
    p["gyro_offset"] = np.radians(sensor.gyro_bias_dps)
    p["accel_bias"] = np.multiply(sensor.accel_bias_g, G)
    p["gyro_drift"] = np.radians(sensor.warm_up_drift_dps)
    p["warm_up"] = sensor.warm_up_s
    p["torque_noise"] = settings.torque_noise * np.array([2.0, 2.0, 0.5])
    p["force_noise"] = settings.torque_noise * 0.1
    if settings.plant != "faithful":
        p["gyro_noise"] = settings.sensor_noise * math.radians(0.10)
        p["accel_noise"] = settings.sensor_noise * 0.01 * G
        p["angle_noise"] = settings.sensor_noise * math.radians(0.02)
        p["ideal_attitude"], p["in_step"] = not settings.estimated, 1
        p["sensor_period_ns"] = PASS_NS
        p["timer_jitter"] = 1.0
    else:
        _faithful(p, vehicle, settings)
        if is_today:  # a BMI088, read 1000 times a second in step with the loop
            corners_hz = today.GYRO_BANDWIDTH_HZ, today.ACCELEROMETER_BANDWIDTH_HZ
            p["dlpf_s"] = [1 / (2 * math.pi * corner_hz) for corner_hz in corners_hz]
            p["pipeline_ns"] = round(today.BUS_S * 1e9)
            p["sensor_phase_ns"] = round(phase * 1e9)
            p["plane_drag"] = today.DRAG_PER_S * vehicle.mass_kg
            p["pwm_steps"] = 0 if today.needs_arming(vehicle) else today.PWM_STEPS
        else:
            _sensor_timing(p, sensor, phase, ppm)
    if is_today:
        p["sensor_period_ns"] = round(1e9 / today.LOOP_HZ)
        p["filtered"] = 1
        p["gyro_filter"] = today.low_pass(vehicle.gyro_filter_hz)
        p["accel_filter"] = today.low_pass(vehicle.accelerometer_filter_hz)
    flown_by_law = []
    if model is not None:
        flown_by_law += _fly_model(p, model, settings)
    hidden = {name: dict(values) for name, values in settings.effects.items()}
    for name in [name for name in hidden if name not in IMPLEMENTED and name in LISTED]:
        flown_by_law.append((LISTED[name], LISTED[name].values(hidden.pop(name))))
    apply_effects(p, hidden)
    if flown_by_law:
        apply_laws(p, flown_by_law)
    most_ns = (SENSOR_RING - 2) * (PASS_NS if p["filtered"] == 0 else p["sensor_period_ns"])
    if p["pipeline_ns"] > most_ns:
        raise ValueError(
            f"sensor delay_s and dead_time make {p['pipeline_ns'] * 1e-6:g} ms of delay,"
            f" must be at most {most_ns * 1e-6:g}"
        )
    return record


def _fly_model(p: Any, model: Model, settings: StandInSettings) -> list[Acting]:
    """Motors and effects of a model in the place of the plant's; returns those that have no
    implementation here."""
    for rotor, motor in enumerate(rotor_motors(model)):
        p["a0"][rotor], p["a1"][rotor], p["a2"][rotor] = motor.a0, motor.a1, motor.a2
    terms = {term.name: {k: e.value for k, e in term.parameters.items()} for term in model.effects}
    if p["filtered"] != 0:
        for field, name in (
            ("gyro_filter", "gyro_filter"),
            ("accel_filter", "accelerometer_filter"),
        ):
            if name in terms:  # the firmware's own, which runs in its loop
                p[field] = today.low_pass(terms.pop(name)["corner_hz"])
    if settings.sensor.delay_s is not None and "dead_time" in terms:
        raise ValueError(
            "sensor delay_s: the model has dead_time, which is the same delay; leave it out"
        )
    replace_effects(p, {name: one for name, one in terms.items() if name in IMPLEMENTED})
    laws = [
        find_effect(one.name, one.source)
        for one in model.effects
        if one.name not in IMPLEMENTED and one.name in terms
    ]
    # Its telemetry has no rotor speeds that a sensor could show.
    laws = [effect for effect in laws if effect.role is not Role.WITH_BASE]
    return [(effect, effect.values(terms[effect.name])) for effect in laws]


def firmware(settings: StandInSettings) -> NDArray[np.void]:
    """The FIRMWARE record at power-on, shape (1,)."""
    vehicle, model = craft_of(settings)
    record = np.zeros(1, FIRMWARE)
    fw = record[0]
    is_today = firmware_of(settings, vehicle) == "2.x"
    for name, values in (today.stock_gains(vehicle) if is_today else STOCK).items():
        fw[name] = values
    fw["fusion_kp"], fw["fusion_ki"], fw["accel_factor"] = 0.8, 0.002, 32.0
    fw["arms_itself"] = not (is_today and today.needs_arming(vehicle))
    fw["protocol"], fw["supervisor"] = settings.supervised_as, NOT_PASSED
    fw["tilted_ns"] = fw["turned_ns"] = -1
    if is_today:
        fw["today"], fw["accel_factor"] = 1, 256.0  # the fusion sees what is logged
        fw["knows_height"], fw["knows_place"] = settings.knows_height, settings.knows_place
        fw["kalman"] = fw["kalman_reset"] = settings.flow_deck
        fw["base_thrust"], fw["least_thrust"] = today.base_thrust(vehicle), today.LEAST_THRUST
        if settings.knows_height:  # by the Kalman filter, where its own model does not fly
            known = [settings.positioned, settings.positioned, True] * 2
            fw["place_variance"] = np.where(known, KNOWN_VARIANCE, UNKNOWN_VARIANCE)
        fw["resets_modes"] = settings.begins_anew
        curve = today.thrust_curve(vehicle, settings.release, model)
        fw["thrust_curve"], fw["thrust_most_n"] = curve.newtons, curve.most_n
        fw["thrust_least_n"], fw["by_grams"] = curve.least_n, curve.by_grams
        fw["idle"] = today.idle_pwm(vehicle)
        fw["compensates"] = curve.battery and not settings.software_build
    fw["altitude_hold"] = float(settings.altitude_hold)
    fw["pilot_holds"] = settings.altitude_hold or not is_today
    quirks = settings.quirks
    fw["quirk_attitude_dt"] = quirks.attitude_dt
    fw["quirk_clamp_macro"] = quirks.clamp_macro
    fw["quirk_lower_limit"] = quirks.lower_limit
    fw["quirk_negate"] = quirks.negate
    fw["quaternion"][0] = 1.0
    fw["client_ns"] = -1
    for name, value in {**vehicle.gains, **settings.gains}.items():
        set_in(fw, name, value)
    return record


def gain_place(name: str) -> tuple[str, int]:
    """Where a parameter lives in the FIRMWARE record: (field, index), index -1 for a scalar.

    Raises ValueError for a name that the firmware does not have.
    """
    if name in PARAMETER_NAMES:
        return PARAMETER_NAMES[name]
    if name in NAMES_OF_TODAY:
        return NAMES_OF_TODAY[name]
    raise ValueError(f"firmware parameter {name!r}: there are {', '.join(PARAMETER_NAMES)}")


def value_in(record: Any, name: str) -> float:
    """A parameter in a FIRMWARE record."""
    column, axis = gain_place(name)
    value = record[column]
    return float(value if axis < 0 else value[axis])


def set_in(record: Any, name: str, value: float) -> None:
    """Set it there."""
    column, axis = gain_place(name)
    if axis < 0:
        record[column] = value
    else:
        record[column][axis] = value


def firmware_of(settings: StandInSettings, vehicle: Vehicle) -> str:
    """Whose loops fly: ``2014`` or ``2.x``."""
    return settings.firmware or vehicle.firmware


def hover_thrust(settings: StandInSettings) -> float:
    """16-bit thrust that carries the craft: of 2014 at 3.7 V."""
    vehicle, model = craft_of(settings)
    if firmware_of(settings, vehicle) == "2.x":
        curve = today.thrust_curve(vehicle, settings.release, model)
        return today.hover_command(vehicle, curve)
    rotor = math.sqrt(G / (4 * vehicle.thrust_per_mass))
    return vehicle.motor.armature_mv(rotor) / 3700.0 * 65536.0


PARAMETER_NAMES = {
    **{
        f"{group}.{letter}_{gain}": (f"{kind}_{gain}", axis)
        for group, kind in (("pid_attitude", "angle"), ("pid_rate", "rate"))
        for axis, letter in enumerate(("roll", "pitch", "yaw"))
        for gain in ("kp", "ki", "kd")
    },
    "sensorfusion6.kp": ("fusion_kp", -1),
    "sensorfusion6.ki": ("fusion_ki", -1),
    "imu_acc_lpf.factor": ("accel_factor", -1),
    "flightmode.althold": ("altitude_hold", -1),
}
"""The firmware's parameters by full name, in the order of its table of contents."""
DRAG_NAMES = {"kalman.dragB_x": ("kalman_drag", 0), "kalman.dragB_y": ("kalman_drag", 1)}
RESET_ESTIMATOR = "kalman.resetEstimation"
"""A Flow deck's estimator begins anew when it is asked to."""
THRUST_NAMES = {
    "posCtlPid.thrustBase": ("base_thrust", -1),
    "posCtlPid.thrustMin": ("least_thrust", -1),
}
NAMES_OF_TODAY = {**DRAG_NAMES, **THRUST_NAMES, RESET_ESTIMATOR: ("kalman_reset", -1)}


def _body(p: Any, vehicle: Vehicle) -> None:
    p["mass"], p["gravity"], p["inertia"] = vehicle.mass_kg, G, vehicle.inertia_kg_m2
    places = rotor_positions_m(vehicle)
    p["rotor_x"], p["rotor_y"] = [x for x, _ in places], [y for _, y in places]
    p["spin"], p["strength"] = (1.0, -1.0, 1.0, -1.0), 1.0
    p["thrust"], p["drag"] = vehicle.thrust_n, vehicle.drag_n_m
    motor = vehicle.motor
    p["a0"], p["a1"], p["a2"], p["braking"] = motor.a0, motor.a1, motor.a2, 1.0
    p["airframe_x"] = vehicle.configuration == "x"
    p["states"] = CORE_STATES


def _power(p: Any, vehicle: Vehicle, settings: StandInSettings) -> None:
    battery = vehicle.battery
    p["winding_ohm"] = vehicle.winding_ohm
    p["back_emf"] = vehicle.motor.a1 / vehicle.motor.a0
    p["internal_ohm"] = battery.internal_ohm
    p["emf_share"], p["electronics_a"] = battery.back_emf_share, battery.electronics_a
    p["capacity_c"] = battery.capacity_mah * 3.6
    p["stiff_mv"] = 0.0 if settings.supply_v is None else 1000.0 * settings.supply_v
    p["swap_ns"] = round(settings.recharge_s * 1e9)


def _faithful(p: Any, vehicle: Vehicle, settings: StandInSettings) -> None:
    """What a real craft has and the base model has not."""
    p["states"] = ALL_STATES
    p["supply_ohm"] = vehicle.battery.supply_ohm
    p["protection_a"] = today.protection_a(vehicle)
    p["start_mv"] = 800.0
    p["adc_filter"] = 1
    p["coupling"] = 1.0
    p["rotor_inertia_gyro"] = p["rotor_inertia_yaw"] = vehicle.rotor_inertia_kg_m2
    p["gyro_noise"] = settings.sensor_noise * math.radians(0.08)
    p["accel_noise"] = settings.sensor_noise * 0.006 * G
    p["timer_jitter"] = 1.0
    in_plane, axial, rate = settings.sensor.shake
    p["shake"] = in_plane * G, axial * G, math.radians(rate)


def _sensor_timing(p: Any, sensor: Sensor, phase: float, ppm: float) -> None:
    (bandwidth, gyro_delay), (_, accel_delay) = DLPF[sensor.dlpf]
    gyro_lag = min(1 / (2 * math.pi * bandwidth), gyro_delay)
    pure_delay = gyro_delay - gyro_lag
    # One register read-out serves both: the accelerometer's lag makes up its own total delay.
    p["dlpf_s"] = gyro_lag, accel_delay - pure_delay
    pipeline = pure_delay + BUS_S
    if sensor.delay_s is not None:
        # The loop fetches a sample half a period after it is ready on average.
        pipeline = sensor.delay_s - gyro_lag - 0.5 * PASS_NS * 1e-9
        if pipeline < 0:
            raise ValueError(f"sensor delay_s {sensor.delay_s}: shorter than the DLPF's own lag")
    clock_ppm = ppm if sensor.clock_ppm is None else sensor.clock_ppm
    p["pipeline_ns"] = round(pipeline * 1e9)
    p["sensor_phase_ns"] = round((phase if sensor.phase_s is None else sensor.phase_s) * 1e9)
    p["sensor_period_ns"] = round(PASS_NS * (1 + clock_ppm * 1e-6))


def present_effects(settings: StandInSettings) -> dict[str, dict[str, float]]:
    """Every listed effect that the stand-in contains, hidden or always there: name -> parameter ->
    true value. The answer that a search is judged by."""
    p = parameters(settings)[0]
    found = {name: one.present(p) for name, one in IMPLEMENTED.items() if one.listed}
    return {name: values for name, values in found.items() if values is not None}


def added_by_plant(settings: StandInSettings) -> str:
    """In a line, what the plant adds to a fitted model that flies in it; empty for nothing."""
    _, model = craft_of(settings)
    if model is None:
        return ""
    plain = msgspec.structs.replace(settings, effects={})
    known = {term.name for term in model.effects}
    added = []
    for name, values in present_effects(plain).items():
        if name not in known:
            units = {key: unit for key, (_, unit) in IMPLEMENTED[name].parameters.items()}
            sizes = {key: Estimate(value, unit=units[key]) for key, value in values.items()}
            added.append(repr(EffectTerm(name, sizes)))
    if model.origin.get("body") == "profile":
        added.insert(0, f"body constants of the profile {model.vehicle}")
    if parameters(plain)[0]["shake"].any():
        added.append("vibration")
    return f"not in the model, added by the plant: {'; '.join(added)}" if added else ""
