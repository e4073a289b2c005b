"""Laws of physics that the plant must keep."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from firmware_sim.layout import ALL_STATES, FREE
from groundstation.dynamics.model import THESIS, save_model
from groundstation.dynamics.vehicle import THESIS_MOTOR, MotorConstants, load_vehicle, mean_motor
from support.plant import fly, plant, rotation, slopes

G = 9.80665


def angular_momentum(p, s):
    """Inertial angular momentum of body and rotors."""
    y = s["y"][0]
    rotors = p["rotor_inertia_yaw"][0] * 2 * math.pi * (p["spin"][0] @ y[13:17])
    body = p["inertia"][0] * y[10:13] + np.array([0.0, 0.0, rotors])
    return rotation(y[6:10]) @ body


def spin_energy(p, s):
    return 0.5 * float(p["inertia"][0] @ s["y"][0, 10:13] ** 2)


def test_two_seconds_of_free_fall_give_19_6_m_s():
    p, s = plant()
    fly(p, s, 2.0)
    assert s["y"][0, 5] == pytest.approx(-2 * G, rel=1e-12)
    assert s["y"][0, 2] == pytest.approx(1000 - 2 * G, rel=1e-12)
    assert np.abs(s["force"][0]).max() < 1e-12


@pytest.mark.parametrize("plant_kind", ["reduced", "faithful"])
def test_the_faithful_plant_falls_as_the_reduced_one(plant_kind):
    p, s = plant(plant=plant_kind)
    s["y"][0, 3:6] = 1.0, -2.0, 0.0
    fly(p, s, 1.0)
    assert s["y"][0, 3:6] == pytest.approx([1.0, -2.0, -G], abs=1e-9)


def test_without_torque_angular_momentum_and_energy_stay():
    p, s = plant()
    p["coupling"] = 1.0
    p["inertia"][0] = 1.0e-5, 1.4e-5, 1.9e-5
    s["y"][0, 10:13] = 6.0, -4.0, 9.0
    momentum, energy = angular_momentum(p, s), spin_energy(p, s)
    fly(p, s, 2.0)
    assert angular_momentum(p, s) == pytest.approx(momentum, rel=1e-6)
    assert spin_energy(p, s) == pytest.approx(energy, rel=1e-6)


def test_a_gyroscopic_torque_does_no_work():
    p, s = plant()
    p["rotor_inertia_gyro"] = 2e-7
    p["thrust"] = p["drag"] = p["a0"] = p["a1"] = p["a2"] = 0.0
    s["y"][0, 13:17] = 300.0, 100.0, 280.0, 120.0
    s["y"][0, 10:13] = 5.0, -3.0, 2.0
    energy = spin_energy(p, s)
    fly(p, s, 2.0)
    assert spin_energy(p, s) == pytest.approx(energy, rel=1e-6)
    assert abs(s["y"][0, 10] - 5.0) > 1.0  # the rates have turned all the same


def test_body_and_rotors_together_keep_their_angular_momentum_while_rotors_change_speed():
    p, s = plant()
    p["coupling"] = 1.0
    p["rotor_inertia_gyro"] = p["rotor_inertia_yaw"] = 5e-7
    p["thrust"] = p["drag"] = 0.0
    s["y"][0, 13:17] = 200.0, 210.0, 220.0, 100.0
    s["y"][0, 10:13] = 3.0, -2.0, 1.0
    s["duty"][0] = 0.9, 0.2, 0.8, 0.1
    s["supply_mv"] = 3700.0
    momentum = angular_momentum(p, s)
    fly(p, s, 0.5)
    assert np.abs(np.diff(s["y"][0, 13:17])).max() > 50
    assert angular_momentum(p, s) == pytest.approx(momentum, rel=1e-6)


@pytest.mark.parametrize("craft", ["crazyflie1", "crazyflie21"])
def test_a_craft_hovers_at_the_rotor_speed_its_thrust_curve_says(craft):
    p, s = plant(craft=craft)
    vehicle = load_vehicle(craft)
    speed = math.sqrt(vehicle.mass_kg * G / (4 * vehicle.thrust_n))
    s["y"][0, 13:17] = speed
    s["duty"][0] = 0.5
    s["supply_mv"] = vehicle.motor.armature_mv(speed) / 0.5
    assert np.abs(slopes(p, s)[3:6]).max() < 1e-9
    fly(p, s, 1.0)
    assert s["y"][0, 2] == pytest.approx(1000.0, abs=1e-6)


@pytest.mark.parametrize(
    ("craft", "signs"),
    [
        ("crazyflie1", [(0, -1, -1), (-1, 0, 1), (0, 1, -1), (1, 0, 1)]),
        ("crazyflie21", [(-1, -1, -1), (-1, 1, 1), (1, 1, -1), (1, -1, 1)]),
    ],
)
def test_each_rotor_of_a_frame_turns_the_craft_the_stated_way(craft, signs):
    for rotor in range(4):
        p, s = plant(craft=craft)
        s["y"][0, 13 + rotor] = 250.0
        turned = np.sign(np.round(slopes(p, s)[10:13], 9))
        assert turned == pytest.approx(signs[rotor]), rotor


def test_the_thesis_model_accelerates_by_its_own_constants():
    p, s = plant(craft="thesis")
    s["y"][0, 13:17] = 200.0, 210.0, 240.0, 230.0
    n = s["y"][0, 13:17] ** 2
    assert slopes(p, s)[10:13] == pytest.approx(
        [
            0.0136 * (n[3] - n[1]),
            0.0136 * (n[2] - n[0]),
            0.0005 * (-n[0] + n[1] - n[2] + n[3]),
        ],
        rel=1e-12,
    )
    assert s["force"][0] == pytest.approx([0, 0, 4.2e-5 * n.sum()], rel=1e-12)


def test_halving_the_step_shrinks_the_error_sixteenfold():
    finals = []
    for steps in (1, 2, 4, 64):
        p, s = plant(plant="faithful")
        p["states"] = 17
        p["longest_step"] = 0.04 / steps
        s["y"][0, 10:13] = 4.0, -3.0, 5.0
        s["y"][0, 13:17] = 200.0, 250.0, 230.0, 260.0
        s["duty"][0] = 0.5, 0.7, 0.6, 0.8
        s["supply_mv"] = 3700.0
        fly(p, s, 0.4, chunk_s=0.04)
        finals.append(s["y"][0, :17].copy())
    errors = [np.abs(final - finals[-1]).max() for final in finals[:-1]]
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.25)
    assert errors[1] / errors[2] == pytest.approx(16, rel=0.25)


def closed_form(time_s, armature_mv, start):
    """Solution of dn/dt = a0 u - a1 n - a2 n^2 for constant u."""
    a0, a1, a2 = THESIS_MOTOR.a0, THESIS_MOTOR.a1, THESIS_MOTOR.a2
    root = math.sqrt(a1 * a1 + 4 * a2 * a0 * armature_mv)
    high, low = (root - a1) / (2 * a2), (-root - a1) / (2 * a2)
    ratio = (start - high) / (start - low) * math.exp(-root * time_s)
    return (high - low * ratio) / (1 - ratio)


@pytest.mark.parametrize(("start", "armature_mv"), [(0.0, 3700.0), (100.0, 2500.0), (300.0, 900.0)])
def test_motor_steps_follow_the_closed_form(start, armature_mv):
    p, s = plant()
    s["y"][0, 13:17] = start
    s["duty"][0], s["supply_mv"] = 0.5, 2 * armature_mv
    for step in range(1, 101):
        fly(p, s, 0.002, chunk_s=0.002)
        expected = closed_form(0.002 * step, armature_mv, start)
        assert s["y"][0, 13] == pytest.approx(expected, rel=1e-6)


def test_the_rotors_of_a_model_turn_by_their_own_motors(tmp_path):
    motors = tuple(MotorConstants(0.8 + 0.05 * i, 6.0 + i, 0.003 * i) for i in range(4))
    model = msgspec.structs.replace(THESIS, motor=mean_motor(motors), motors=motors)
    save_model(model, tmp_path / "model.json")
    p, s = plant(craft=str(tmp_path / "model.json"))
    s["duty"][0], s["supply_mv"] = 0.5, 5000.0
    fly(p, s, 4.0)
    assert s["y"][0, 13:17] == pytest.approx([one.steady_rev_s(2500.0) for one in motors])


def test_a_motor_at_rest_needs_its_starting_voltage():
    for armature_mv, turns in ((700.0, False), (900.0, True)):
        p, s = plant(plant="faithful")
        s["duty"][0], s["supply_mv"] = 0.25, 4 * armature_mv
        fly(p, s, 0.5)
        assert (s["y"][0, 13] > 10) == turns


def test_a_motor_that_turns_goes_on_below_its_starting_voltage():
    p, s = plant(plant="faithful")
    s["y"][0, 13:17] = 100.0
    s["duty"][0], s["supply_mv"] = 0.2, 3500.0
    fly(p, s, 0.5)
    assert s["y"][0, 13] > 50


def test_a_craft_stands_on_the_ground_and_feels_its_weight():
    p, s = plant()
    s["y"][0, 2] = 0.0
    s["y"][0, 5] = -1.0  # touches down at 1 m/s
    s["y"][0, 10] = 1.0
    heights = []
    for _ in range(100):
        fly(p, s, 0.01)
        heights.append(s["y"][0, 2])
    assert max(heights) < 0.005
    assert s["mode"][0] == FREE
    assert s["y"][0, 2] == pytest.approx(-G / 125**2, abs=1e-5)
    assert np.abs(s["y"][0, 10:13]).max() < 1e-3
    slopes(p, s)
    assert s["force"][0] == pytest.approx([0, 0, G], abs=0.01)


def test_the_extra_states_do_not_change_the_flight():
    finals = []
    for states in (17, ALL_STATES):
        p, s = plant()
        p["states"] = states
        s["y"][0, 10:13] = 1.0, 2.0, -1.0
        s["y"][0, 13:17] = 240.0
        fly(p, s, 0.5)
        finals.append(s["y"][0, :17].tobytes())
    assert finals[0] == finals[1]
