"""The compiled bodies: two derivations of one physics, and what physics must conserve."""

import numpy as np
import pytest

from groundstation.dynamics.craft import craft_of_model, craft_of_vehicle
from groundstation.dynamics.model import THESIS, vehicle_model
from groundstation.dynamics.rotations import matrix_of_quaternion
from groundstation.dynamics.simulation import (
    POSITION,
    QUATERNION,
    RATE,
    ROTOR,
    VELOCITY,
    attitude_of,
    craft_state,
    simulate,
    simulate_batch,
    specific_force,
)
from groundstation.dynamics.vehicle import BUILT_IN
from support.equations import lagrange_flown as flown
from support.equations import mix

CRAZYFLIE = BUILT_IN["crazyflie1"]
HOVER_MV = CRAZYFLIE.motor.armature_mv(np.sqrt(9.80665 / 4 / CRAZYFLIE.thrust_per_mass))


def voltages(steps, amplitude, seed=0, period=1e-3):
    """Hover, each motor with its own slow sines."""
    time = np.arange(steps)[:, None] * period
    pulsation = np.array([2.1, 3.4, 4.7, 5.9]) + seed
    return HOVER_MV + amplitude * np.sin(pulsation * time)


def rigid(coupling=1.0, gyroscopic=4e-8, spin_up=4e-8):
    """The craft with a rigid body's own torques, each in some strength."""
    return craft_of_vehicle(
        CRAZYFLIE,
        {
            "inertia_coupling": {"fraction": coupling},
            "rotor_gyroscopic_torque": {"rotor_inertia_kg_m2": gyroscopic},
            "rotor_acceleration_torque": {"rotor_inertia_kg_m2": spin_up},
        },
    )


@pytest.mark.parametrize(
    ("gyroscopic", "spin_up", "rotors"),
    [(0.0, 0.0, 0.0), (4e-8, 0.0, 255.0), (0.0, 4e-8, 255.0), (4e-8, 4e-8, 255.0)],
    ids=["no torque", "rotor momentum", "spin-up", "both"],
)
def test_newton_euler_equals_lagrange(gyroscopic, spin_up, rotors):
    craft = rigid(gyroscopic=gyroscopic, spin_up=spin_up)
    craft["inertia"] = 1.0e-5, 1.3e-5, 1.9e-5
    start = craft_state(attitude=(0.8, 0.2, -1.5), rates=(0.3, -0.15, 0.4), rotor_rev_s=rotors)
    voltage = (HOVER_MV + np.array([4.0, -6.0, 3.0, -2.0])) * (rotors > 0)
    one = simulate(craft, start, np.tile(voltage, (2000, 1)), period_s=5e-4)[-1]
    position, attitude, rates = flown(craft, start, voltage, 1.0, gyroscopic, spin_up)
    np.testing.assert_allclose(attitude_of(one), attitude, atol=1e-8)
    np.testing.assert_allclose(one[RATE], rates, atol=1e-8)
    np.testing.assert_allclose(one[POSITION], position, atol=1e-8)
    assert np.abs(one[RATE] - start[RATE]).max() > 1e-2


def test_two_seconds_of_free_fall_reach_19_6_m_s():
    states = simulate(rigid(), craft_state(rates=(1.0, -2.0, 3.0)), np.zeros((1000, 4)))
    np.testing.assert_allclose(states[-1, VELOCITY], [0, 0, -2 * 9.80665], rtol=1e-12)
    np.testing.assert_allclose(states[-1, POSITION], [0, 0, -2 * 9.80665], rtol=1e-12)


def test_without_torque_energy_and_angular_momentum_stay():
    craft = rigid()
    inertia = np.array([1.0e-5, 1.3e-5, 1.9e-5])
    craft["inertia"] = inertia
    start = craft_state(attitude=(0.3, -0.5, 1.0), rates=(4.0, 7.0, -3.0))
    states = simulate(craft, start, np.zeros((5000, 4)))
    rates = states[:, RATE]
    energy = 0.5 * (rates**2 @ inertia)
    momentum = np.einsum("kij,kj->ki", matrix_of_quaternion(states[:, QUATERNION]), rates * inertia)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-7)
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (5001, 1)), atol=1e-7 * 1e-4)
    assert np.ptp(rates, axis=0).min() > 1.0  # it does tumble


def test_the_gyroscopic_torque_does_no_work():
    """Equal voltages on rotors of unequal speeds: a large omega, no torque but the rotors' own."""
    craft = rigid(coupling=0.0, gyroscopic=4e-7, spin_up=0.0)
    craft["thrust"], craft["drag"] = 0.0, 0.0
    start = craft_state(rates=(3.0, -1.0, 2.0), rotor_rev_s=(300, 0, 300, 0))
    states = simulate(craft, start, np.zeros((500, 4)), substeps=32)
    energy = 0.5 * (states[:, RATE] ** 2 @ craft["inertia"][0])
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    assert np.ptp(states[:, 10]) > 1.0


def test_rotors_and_body_keep_their_total_angular_momentum_without_air():
    """Gyroscopic and spin-up torques together are the conservation of momentum about every axis."""
    craft = rigid(gyroscopic=4e-7, spin_up=4e-7)
    craft["thrust"], craft["drag"] = 0.0, 0.0
    start = craft_state(
        attitude=(0.2, 0.1, 0.4), rates=(2.0, 1.0, -1.5), rotor_rev_s=(100, 300, 200, 50)
    )
    states = simulate(craft, start, voltages(1000, 500.0), substeps=4)
    spin = states[:, ROTOR] @ [1, -1, 1, -1] * 2 * np.pi * 4e-7
    momentum = states[:, RATE] * craft["inertia"][0]
    momentum[:, 2] += spin
    inertial = np.einsum("kij,kj->ki", matrix_of_quaternion(states[:, QUATERNION]), momentum)
    np.testing.assert_allclose(inertial, np.tile(inertial[0], (1001, 1)), atol=1e-9 * 1e-3)
    assert np.ptp(spin) > 1e-5


def test_halving_the_step_divides_the_error_by_sixteen():
    craft = rigid()
    start = craft_state(attitude=(0.4, 0.3, 0.2), rates=(2.0, -1.0, 3.0), rotor_rev_s=250)
    voltage = voltages(10, 40.0, period=0.04)

    def end(substeps):
        return simulate(craft, start, voltage, period_s=0.04, substeps=substeps)[-1]

    exact = end(256)
    errors = [np.linalg.norm(end(n) - exact) for n in (4, 8, 16)]
    np.testing.assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 16, rtol=0.25)


def test_a_hovering_craft_stays_where_it_is():
    craft = craft_of_vehicle(CRAZYFLIE)
    start = craft_state(rotor_rev_s=CRAZYFLIE.motor.steady_rev_s(HOVER_MV))
    states = simulate(craft, start, np.full((500, 4), HOVER_MV))
    np.testing.assert_allclose(states[-1], start, atol=1e-9)
    np.testing.assert_allclose(specific_force(craft, states)[-1], [0, 0, 9.80665], rtol=1e-9)


def test_a_model_flies_with_exactly_its_constants():
    craft = craft_of_model(THESIS)
    speeds = np.array([240.0, 250.0, 245.0, 262.0])
    start = craft_state(rotor_rev_s=speeds)
    held = [THESIS.motor.armature_mv(speed) for speed in speeds]
    states = simulate(craft, start, np.tile(held, (5, 1)), period_s=1e-3)
    body = THESIS.body
    expected = np.array([body.c0, body.c1, body.c2]) * mix(speeds)
    np.testing.assert_allclose(states[-1, RATE], 5e-3 * expected, rtol=1e-9)
    force = specific_force(craft, states[0])
    assert force[2] == pytest.approx(body.thrust_per_mass * (speeds**2).sum())


def test_the_model_of_a_profile_flies_like_the_profile():
    for vehicle in BUILT_IN.values():
        one = craft_of_model(vehicle_model(vehicle))
        other = craft_of_vehicle(vehicle)
        for name in one.dtype.names:
            np.testing.assert_allclose(one[name], other[name], rtol=1e-12, err_msg=name)


def test_a_batch_over_parameters_and_seeds_gives_what_single_flights_give():
    crafts = np.concatenate([craft_of_vehicle(CRAZYFLIE)] * 5)
    crafts["thrust"] *= np.linspace(0.9, 1.1, 5)
    noise = np.random.default_rng(0).normal(0, 1.0, (5, 200, 6))
    start = craft_state(rotor_rev_s=250)
    voltage = voltages(200, 30.0)
    together = simulate_batch(crafts, start, voltage, disturbance=noise)
    for index in range(5):
        alone = simulate(crafts[index : index + 1], start, voltage, disturbance=noise[index])
        np.testing.assert_array_equal(together[index], alone)


def test_a_disturbance_is_an_acceleration_of_the_body():
    craft = craft_of_vehicle(CRAZYFLIE)
    craft["gravity"] = 0.0
    push = np.tile([1.0, 2.0, 3.0, 0.1, 0.2, 0.3], (10, 1))
    states = simulate(craft, craft_state(), np.zeros((10, 4)), disturbance=push)
    np.testing.assert_allclose(states[-1, VELOCITY], [0.002, 0.004, 0.006], rtol=1e-9)
    np.testing.assert_allclose(states[-1, RATE], [0.02, 0.04, 0.06], rtol=2e-3)


@pytest.mark.parametrize(
    ("initial", "voltage", "text"),
    [
        (np.zeros(16), np.zeros((5, 4)), "need"),
        (np.zeros(17), np.zeros((5, 3)), "voltage_mv"),
        (np.zeros((3, 17)), np.zeros((2, 5, 4)), "batch lengths"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(initial, voltage, text):
    with pytest.raises(ValueError, match=text):
        simulate_batch(craft_of_vehicle(CRAZYFLIE), initial, voltage)
