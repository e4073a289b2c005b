"""Each hidden effect by itself, against its law written out by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.effects.catalogue import EFFECTS
from firmware_sim.imu import lever_arm_acceleration
from firmware_sim.layout import ARM, LOAD, PHASE
from groundstation.dynamics.registry import EFFECTS as NAMED
from support.plant import QUIET, callable_piece, flown, fly, plant, rotation, slopes

G = 9.80665
NEUTRAL = {"motor_braking_asymmetry": {"factor": 1.0}, "rotor_mismatch": {"excess": 0.0}}
SIZES = {
    "centre_of_gravity_offset": {"x_m": 5e-4, "y_m": -3e-4},
    "gyro_bias": {"x_dps": 1.0},
    "accelerometer_bias": {"z_g": 0.02},
    "imu_misalignment": {"pitch_deg": 2.0},
    "imu_lever_arm": {"x_m": 0.003},
}


def test_every_name_of_the_design_can_be_hidden_and_three_more():
    by_law = {"accelerometer_filter", "gyro_filter", "rotor_speed_sensor"}
    assert {name for name, effect in EFFECTS.items() if effect.listed} == set(NAMED) - by_law
    assert set(EFFECTS) - set(NAMED) - {"rotor_inertia"} == {
        "cracked_arm",
        "bent_propeller",
        "side_gust",
    }


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_an_effect_of_size_zero_leaves_every_bit_as_it_was(name):
    zero = {parameter: 0.0 for parameter in EFFECTS[name].parameters if parameter != "rotor"}
    if name == "ground_effect":
        zero = {"gain": 0.0}
    if name in ("wind", "position_aided_lean"):
        zero.pop("time_s")
    zero = NEUTRAL.get(name, zero)
    if name in ("slung_load", "cracked_arm"):
        zero = {"percent": 0.0} if name == "slung_load" else {"gain": 0.0}
    packets = [
        StandIn(StandInSettings(plant="reduced", effects=effects)).advance(12.0)[0].tobytes()
        for effects in ({}, {name: zero})
    ]
    assert packets[0] == packets[1]


IN_FULL = {"attitude_filter_lean", "inertia_coupling"}
"""What the faithful plant contains already."""
CASES = [("reduced", name) for name in sorted(EFFECTS)] + [
    ("faithful", name) for name in sorted(set(EFFECTS) - IN_FULL)
]


@pytest.mark.parametrize(("plant_kind", "name"), CASES)
def test_an_effect_changes_the_flight(plant_kind, name):
    flights = [
        StandIn(StandInSettings(plant=plant_kind, effects=effects)).advance(12.0)[0]
        for effects in ({}, {name: SIZES.get(name, {})})
    ]
    shorter = min(map(len, flights))
    assert (flights[0][:shorter] != flights[1][:shorter]).any(axis=1).mean() > 0.1


def moving_plant(effects: dict[str, dict[str, float]]) -> tuple[Any, Any]:
    p, s = plant(effects=effects)
    y = s["y"][0]
    y[3:6] = 0.7, -0.4, 0.3
    quaternion = np.array([0.95, 0.1, -0.2, 0.15])
    y[6:10] = quaternion / np.linalg.norm(quaternion)
    y[10:13] = 2.0, -1.5, 1.2
    y[13:17] = 230.0, 250.0, 245.0, 238.0
    s["duty"][0] = 0.6, 0.62, 0.3, 0.64
    s["supply_mv"] = 3700.0
    return p, s


def change(effects: dict[str, dict[str, float]]) -> tuple[Any, Any, Any, Any]:
    """(parameters, state, change of dy/dt, change of specific force) that effects make."""
    p0, s0 = moving_plant({})
    before, force_before = slopes(p0, s0), s0["force"][0].copy()
    p, s = moving_plant(effects)
    return p[0], s["y"][0], slopes(p, s) - before, s["force"][0] - force_before


def body_velocity(y: Any) -> Any:
    return rotation(y[6:10]).T @ y[3:6]


def spin_sum(y: Any) -> float:
    return 2 * math.pi * float(-y[13] + y[14] - y[15] + y[16])


LAWS: dict[str, tuple[dict[str, float], Callable[[Any, Any], Any]]] = {
    # roll and pitch torque +I_r q w, -I_r p w with w = -n1 + n2 - n3 + n4
    "rotor_gyroscopic_torque": (
        {"rotor_inertia_kg_m2": 8e-8},
        lambda p, y: np.array([y[11] * spin_sum(y), -y[10] * spin_sum(y), 0.0]) * 8e-8,
    ),
    "inertia_coupling": (
        {"fraction": 1.0},
        lambda p, y: -np.cross(y[10:13], p["inertia"] * y[10:13]),
    ),
    "rate_damping": (
        {"damping_n_m_s": 2e-5},
        lambda p, y: -2e-5 * np.array([y[10], y[11], 0.0]),
    ),
    "quadratic_rate_damping": (
        {"damping_n_m_s2": 3e-5},
        lambda p, y: -3e-5 * np.array([y[10] * abs(y[10]), y[11] * abs(y[11]), 0.0]),
    ),
    "yaw_damping": ({"damping_n_m_s": 5e-6}, lambda p, y: -5e-6 * np.array([0.0, 0.0, y[12]])),
    "centre_of_gravity_offset": (
        {"x_m": 1e-3, "y_m": -5e-4},
        lambda p, y: np.cross([-1e-3, 5e-4, 0.0], [0.0, 0.0, p["thrust"] * (y[13:17] ** 2).sum()]),
    ),
    "velocity_moment": (
        {"moment": 12.0, "asymmetry": 0.25},
        lambda p, y: (
            np.array([9.0 * body_velocity(y)[1], -15.0 * body_velocity(y)[0], 0.0]) * p["inertia"]
        ),
    ),
    "rotor_mismatch": (
        {"rotor": 2, "excess": 0.04},
        lambda p, y: 0.04 * y[14] ** 2 * np.array([-p["thrust"] * p["rotor_x"][0], 0.0, p["drag"]]),
    ),
}


@pytest.mark.parametrize("name", sorted(LAWS))
def test_a_torque_obeys_its_law(name):
    parameters, law = LAWS[name]
    p, y, slope, force = change({name: parameters})
    assert slope[10:13] * p["inertia"] == pytest.approx(law(p, y), rel=1e-9, abs=1e-15)
    if name != "rotor_mismatch":
        assert np.abs(force).max() < 1e-12


def test_the_rotors_acceleration_turns_the_craft():
    p, _, slope, _ = change({"rotor_acceleration_torque": {"rotor_inertia_kg_m2": 6e-8}})
    p0, s0 = moving_plant({})
    rotors = slopes(p0, s0)[13:17]
    expected = 6e-8 * 2 * math.pi * (-rotors[0] + rotors[1] - rotors[2] + rotors[3])
    assert slope[12] * p["inertia"][2] == pytest.approx(expected, rel=1e-9)
    assert np.abs(slope[10:12]).max() == 0


def test_a_rotor_inertia_brings_both_torques():
    both = plant(effects={"rotor_inertia": {"rotor_inertia_kg_m2": 6e-8}})[0][0]
    assert both["rotor_inertia_gyro"] == both["rotor_inertia_yaw"] == 6e-8


def test_rotor_drag_acts_against_the_body_velocity_in_the_plane():
    p, y, slope, force = change({"rotor_drag": {"drag_n_s_m": 0.01}})
    forward, left, _ = body_velocity(y)
    assert force == pytest.approx([-0.01 * forward / p["mass"], -0.01 * left / p["mass"], 0.0])
    assert slope[3:6] == pytest.approx(rotation(y[6:10]) @ force)


def test_climbing_costs_thrust():
    _, y, _, force = change({"climb_inflow": {"loss_g_per_m_s": 0.04}})
    assert force == pytest.approx([0, 0, -0.04 * G * body_velocity(y)[2]])


def test_dead_voltage_is_lost_before_the_motor():
    p, _, slope, _ = change({"motor_dead_voltage": {"voltage_mv": 150.0}})
    assert slope[13:17] == pytest.approx(-150.0 * p["a0"])


def test_motors_that_slow_down_do_so_more_slowly():
    p0, s0 = moving_plant({})
    before = slopes(p0, s0)[13:17]
    _, _, slope, _ = change({"motor_braking_asymmetry": {"factor": 0.6}})
    assert before[2] < 0 < before[0]
    assert slope[13:17] == pytest.approx(np.where(before < 0, -0.4 * before, 0.0))


def test_motors_that_coast_fall_by_their_load_and_what_still_brakes():
    p0, s0 = moving_plant({})
    before = slopes(p0, s0)[13:17]
    p, y, slope, _ = change({"motor_coasting": {"share": 0.75}})
    braking = np.minimum(before + p["a2"] * y[13:17] ** 2, 0.0)
    assert braking.min() < 0 == braking.max()
    assert slope[13:17] == pytest.approx(-0.75 * braking)


def test_ground_effect_fades_with_height():
    extra = []
    for height in (0.0, 0.08, 1.0):
        p, s = plant(effects={"ground_effect": {"height_m": 0.08, "gain": 0.25}})
        s["y"][0, 2], s["y"][0, 13:17] = height, 240.0
        slopes(p, s)
        extra.append(s["force"][0, 2] / (p[0]["thrust"] / p[0]["mass"] * 4 * 240.0**2) - 1)
    assert extra == pytest.approx([0.25, 0.25 / math.e, 0.25 * math.exp(-12.5)], rel=1e-9)


def test_supply_sag_is_resistance_times_the_motors_summed_current():
    craft, rows = flown(
        12.0, plant="reduced", supply_v=3.8, truth=True, effects={"supply_sag": {}}, **QUIET
    )
    truth = craft.truth()[3000:]
    p = plant()[0][0]
    # Current and voltage belong to the pass that follows; duty to the one before.
    duty, speed, supply = truth["duty"][1:], truth["rotor_rev_s"][:-1], truth["supply_mv"][1:]
    emf = p["back_emf"] * speed
    current_ma = (duty * (duty * supply[:, None] - emf)).sum(1) / p["winding_ohm"]
    assert supply == pytest.approx(3800.0 - 0.15 * current_ma, abs=1e-6)
    assert rows["battery"][-1] == 3800


def test_the_reported_voltage_lags_the_real_one():
    craft, rows = flown(
        12.0,
        plant="reduced",
        truth=True,
        effects={"battery_reading_lag": {"time_constant_s": 0.3}},
        **QUIET,
    )
    real = craft.truth()["supply_mv"][: len(rows["battery"])]
    gain = 1 - math.exp(-0.002 / 0.3)
    lagged = np.empty_like(real)
    lagged[0] = real[0]
    for i in range(1, len(real)):
        lagged[i] = lagged[i - 1] + gain * (real[i] - lagged[i - 1])
    late = slice(3000, None)
    assert np.abs(lagged - rows["battery"])[late].max() <= 0.51
    assert np.abs(real - rows["battery"])[late].max() > 2


@pytest.mark.parametrize("delay_s", [0.0013, 0.004, 0.0077])
def test_dead_time_shows_the_past_in_every_channel(delay_s):
    craft, rows = flown(
        14.0,
        plant="reduced",
        truth=True,
        gains={"pid_rate.roll_kp": 20.0, "pid_rate.pitch_kp": 20.0},
        effects={"dead_time": {"delay_s": delay_s}},
        **QUIET,
    )
    truth = craft.truth()
    window = slice(5000, 6900)
    past = truth["time_s"][window] - delay_s
    for axis in range(3):
        rate = np.interp(past, truth["time_s"], truth["rate_rad_s"][:, axis])
        seen = np.radians(rows["gyro"][window, axis] / 16.384)
        assert np.abs(rate - seen).max() < 0.01
    thrust = np.interp(past, truth["time_s"], (truth["rotor_rev_s"] ** 2).sum(1))
    assert rows["accelerometer"][window, 2] == pytest.approx(thrust * 4.2e-5 / G * 4096, abs=1.5)
    assert truth["sensor_age_s"][window] == pytest.approx(delay_s, abs=1e-6)


def test_a_low_pass_makes_the_gyro_lag():
    settings = {"plant": "reduced", "truth": True, **QUIET}
    craft, rows = flown(14.0, effects={"gyro_low_pass": {"bandwidth_hz": 20.0}}, **settings)
    truth, lag = craft.truth()[: len(rows["gyro"])], 1 / (2 * math.pi * 20.0)
    filtered = np.zeros(len(truth))
    rate = truth["rate_rad_s"][:, 0]
    decay = math.exp(-0.002 / lag)
    for i in range(1, len(rate)):  # exact for a rate that is linear between the passes
        slope = (rate[i] - rate[i - 1]) / 0.002
        before = filtered[i - 1] - rate[i - 1] + slope * lag
        filtered[i] = rate[i] - slope * lag + before * decay
    seen = np.radians(rows["gyro"][:, 0] / 16.384)
    assert np.abs(filtered - seen)[3000:].max() < 0.01
    assert np.abs(rate - seen)[3000:].max() > 0.1


def test_biases_add_to_the_registers():
    clean, biased = (
        flown(
            3.0,
            plant="reduced",
            program="wait",
            effects=effects,
            **QUIET,
        )[1]
        for effects in (
            {},
            {
                "gyro_bias": {"x_dps": 2.0, "z_dps": -1.0},
                "accelerometer_bias": {"y_g": 0.05},
            },
        )
    )
    gyro = (biased["gyro"] - clean["gyro"])[100:500].mean(0)
    assert gyro == pytest.approx([2 * 16.384, 0, -16.384], abs=0.6)
    force = (biased["accelerometer"] - clean["accelerometer"])[100:500].mean(0)
    assert force == pytest.approx([0, 0.05 * 4096, 0], abs=0.6)


def test_a_misaligned_sensor_sees_gravity_askew():
    _, rows = flown(
        2.0,
        plant="reduced",
        program="wait",
        effects={"imu_misalignment": {"roll_deg": 3.0, "pitch_deg": 2.0}},
        **QUIET,
    )
    roll, pitch = math.radians(3), math.radians(2)
    expected = [
        -math.sin(pitch),
        math.sin(roll) * math.cos(pitch),
        math.cos(roll) * math.cos(pitch),
    ]
    assert rows["accelerometer"][300:].mean(0) / 4096 == pytest.approx(expected, abs=2e-4)


def test_a_misaligned_sensor_reports_its_own_angles_and_rates():
    turned = {"roll_deg": 3.0, "pitch_deg": 2.0, "yaw_deg": 5.0}
    _, rows = flown(
        4.0, plant="reduced", program="wait", effects={"imu_misalignment": turned}, **QUIET
    )
    assert rows["angles"][-100:].mean(0) / 100 == pytest.approx([3, -2, 5], abs=0.02)
    straight, askew = (
        flown(9.0, plant="reduced", program="axis_check", effects=effects, **QUIET)[1]["gyro"]
        for effects in ({}, {"imu_misalignment": {"yaw_deg": 5.0}})
    )
    moving = np.abs(straight[:, 0]) > 200  # about roll: x forward, sensor turned to the left
    shares = askew[moving] / straight[moving, :1]
    cosine, sine = math.cos(math.radians(5)), math.sin(math.radians(5))
    assert shares.mean(0) == pytest.approx([cosine, -sine, 0], abs=2e-3)


def test_a_sensor_away_from_the_centre_feels_the_rotation():
    p, s = moving_plant({"imu_lever_arm": {"x_m": 0.003, "y_m": -0.002, "z_m": 0.001}})
    slope = slopes(p, s)
    rate, arm = s["y"][0, 10:13], np.array([0.003, -0.002, 0.001])
    expected = np.cross(slope[10:13], arm) + np.cross(rate, np.cross(rate, arm))
    assert callable_piece(lever_arm_acceleration)(p[0], s["y"][0], slope) == pytest.approx(
        expected, rel=1e-9
    )


def test_the_attitude_leans_towards_the_accelerometer():
    errors = []
    for effects in ({}, {"attitude_filter_lean": {}}):
        craft, rows = flown(30.0, plant="reduced", truth=True, effects=effects, **QUIET)
        w, x, y, z = craft.truth()["quaternion"][: len(rows["angles"])].T
        roll = np.degrees(np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y)))
        fresh = slice(5000, len(roll), 2)
        errors.append(np.abs(rows["angles"][fresh, 0] / 100 - roll[fresh]).max())
    assert errors[0] < 0.02
    assert errors[1] > 0.5


LOADED = {"percent": 8.0, "length_m": 0.25, "damping_per_s": 0.0, "below_m": 0.01}


def test_a_load_swings_with_the_period_of_its_line():
    p, s = plant(effects={"slung_load": LOADED})
    n = s["y"][0, 13:17] = math.sqrt(p[0]["mass"] * G / 4 / p[0]["thrust"])
    s["duty"][0] = 1.0
    # The motors hold the speed that carries craft and load.
    s["supply_mv"] = ((p[0]["a1"] * n + p[0]["a2"] * n * n) / p[0]["a0"])[0]
    s["y"][0, LOAD] = 0.02
    p["inertia"] = 1.0  # keep the craft level
    swing = []
    for _ in range(300):
        fly(p, s, 0.01)
        swing.append(s["y"][0, LOAD])
    crossings = np.flatnonzero(np.diff(np.sign(swing)) != 0)
    period = 2 * np.diff(crossings).mean() * 0.01
    alone = 2 * math.pi * math.sqrt(0.25 / G)
    # A light craft moves too: the pair swings faster than a load on a fixed line.
    assert period == pytest.approx(alone * math.sqrt(1 - 0.08), rel=0.01)


def test_a_load_that_swings_pulls_along_its_line_below_the_centre():
    p, s = plant(effects={"slung_load": LOADED})
    s["y"][0, 13:17] = 245.0
    mass, share = p[0]["mass"], 0.08
    straight = slopes(p, s)
    assert straight[5] == pytest.approx(p[0]["thrust"] * 4 * 245.0**2 / mass - G)
    line = np.array([0.06, 0.08, -math.sqrt(0.25**2 - 0.06**2 - 0.08**2)]) / 0.25
    s["y"][0, LOAD], s["y"][0, LOAD + 1] = 0.25 * line[:2]
    change = slopes(p, s) - straight
    thrust = np.array([0.0, 0.0, p[0]["thrust"] * 4 * 245.0**2])
    pull = -share * (thrust @ line) * line
    pushed = (thrust + pull) / (1 - share) / mass - thrust / mass
    assert change[3:6] == pytest.approx(pushed)
    torque = np.cross([0.0, 0.0, -0.01], pull)
    assert change[10:13] == pytest.approx(torque / p[0]["inertia"])


def test_a_load_that_lies_on_the_ground_leaves_the_craft_its_own_weight():
    p, s = plant(effects={"slung_load": LOADED})
    s["y"][0, 2], s["y"][0, 13:17] = 0.1, 245.0
    lift = p[0]["thrust"] * 4 * 245.0**2 / (0.92 * p[0]["mass"])
    assert slopes(p, s)[5] == pytest.approx(lift - G)


def test_a_cracked_arm_hands_on_more_thrust_while_it_bends_further():
    p, s = plant(effects={"cracked_arm": {"rotor": 2, "gain": 0.4}})
    s["y"][0, 13:17] = 240.0
    one = p[0]["thrust"] * 240.0**2
    lift = []
    for bend in (one, 1.1 * one):
        s["y"][0, ARM] = bend
        slopes(p, s)
        lift.append(s["force"][0, 2] * p[0]["mass"])
    assert lift == pytest.approx([4 * one, (4 + 0.4 * 0.1) * one])


def test_a_cracked_arm_rings_at_its_own_frequency():
    p, s = plant(effects={"cracked_arm": {"frequency_hz": 40.0, "damping": 0.01}})
    s["y"][0, ARM] = 0.01
    bend = []
    for _ in range(500):
        fly(p, s, 0.001, chunk_s=0.001)
        bend.append(s["y"][0, ARM])
    spectrum = np.abs(np.fft.rfft(bend))
    assert np.fft.rfftfreq(500, 0.001)[spectrum.argmax()] == pytest.approx(40.0, abs=2.0)


def test_a_bent_propeller_shakes_once_per_revolution():
    p, s = plant(effects={"bent_propeller": {"rotor": 3, "torque_n_m": 4e-5}})
    s["y"][0, 13:17] = 250.0
    torque = []
    for phase in (0.0, 0.25, 0.5, 1.25):
        s["y"][0, PHASE + 2] = phase
        torque.append(slopes(p, s)[10:12] * p[0]["inertia"][:2])
    assert np.array(torque) == pytest.approx(
        4e-5 * np.array([[1, 0], [0, 1], [-1, 0], [0, 1]]), abs=1e-12
    )


def test_a_gust_comes_back_with_its_period():
    effects = {"side_gust": {"frequency_hz": 0.5, "force_n": 0.02, "moment_n_m": 2e-5}}
    p, s = plant(effects=effects)
    push = [slopes(p, s, t)[[4, 10]] for t in (0.5, 1.5, 2.5)]
    assert push[0] == pytest.approx([0.02 / p[0]["mass"], 2e-5 / p[0]["inertia"][0]])
    assert push[1] == pytest.approx(-push[0])
    assert push[2] == pytest.approx(push[0])


def test_wind_has_the_spread_and_the_pace_of_noise_through_a_low_pass():
    spread = {f"{what}_{axis}": 1.0 for what in ("moment", "force") for axis in "xyz"}
    p, s = plant(effects={"wind": {**spread, "time_s": 2.0}})
    still, resting = plant()
    times = np.arange(0.0, 400.0, 0.5)
    pushed = np.array([slopes(p, s, t) - slopes(still, resting, t) for t in times])
    for column in (3, 4, 5, 10, 11, 12):
        felt = pushed[:, column]
        assert felt.std() == pytest.approx(1.0, rel=0.15)
        assert felt[4:] @ felt[:-4] / (felt @ felt) == pytest.approx(np.exp(-1.0), abs=0.15)
    others = np.corrcoef(pushed[:, [3, 4, 5, 10, 11, 12]].T) - np.eye(6)
    assert np.abs(others).max() < 0.4


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"rotor_dragg": {}}, "rotor_dragg.*rotor_drag"),
        ({"rotor_drag": {"size": 1.0}}, "no parameter size; there are drag_n_s_m"),
    ],
)
def test_an_effect_that_does_not_exist_is_refused(effects, message):
    with pytest.raises(ValueError, match=message):
        StandIn(StandInSettings(effects=effects))
