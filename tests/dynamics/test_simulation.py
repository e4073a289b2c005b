"""The compiled bodies: two derivations of one physics, and what physics must conserve."""

import numpy as np
import pytest

from groundstation.dynamics.craft import craft_of_model, craft_of_vehicle
from groundstation.dynamics.mixer import mix
from groundstation.dynamics.model import THESIS, vehicle_model
from groundstation.dynamics.rotations import matrix_of_quaternion
from groundstation.dynamics.simulation import (
    BodyModel,
    simulate,
    simulate_batch,
    specific_force,
)
from groundstation.dynamics.state import (
    POSITION,
    QUATERNION,
    RATE,
    ROTOR,
    VELOCITY,
    attitude_of,
    craft_state,
)
from groundstation.dynamics.vehicle import BUILT_IN

CRAZYFLIE = BUILT_IN["crazyflie1"]
HOVER_MV = CRAZYFLIE.motor.armature_mv(np.sqrt(9.80665 / 4 / CRAZYFLIE.thrust_per_mass))


def voltages(steps, amplitude, seed=0, period=1e-3):
    """Hover, each motor with its own slow sines."""
    time = np.arange(steps)[:, None] * period
    pulsation = np.array([2.1, 3.4, 4.7, 5.9]) + seed
    return HOVER_MV + amplitude * np.sin(pulsation * time)


def coasting(**switches):
    """Still rotors at no voltage: no force, no torque."""
    return craft_of_vehicle(CRAZYFLIE, **switches)


@pytest.mark.parametrize("gyroscopic", [False, True], ids=["no rotor momentum", "rotor momentum"])
@pytest.mark.parametrize("spin_up", [False, True], ids=["no spin-up", "spin-up"])
@pytest.mark.parametrize("amplitude", [0.0, 30.0], ids=["no torque", "torque"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_euler_lagrange_equals_newton_euler(gyroscopic, spin_up, amplitude, seed):
    craft = craft_of_vehicle(CRAZYFLIE, gyroscopic=gyroscopic, spin_up=spin_up)
    craft["inertia"] = 1.0e-5, 1.3e-5, 1.9e-5
    generator = np.random.default_rng(seed)
    rotors = 0.0 if amplitude == 0.0 else 255.0
    voltage = np.zeros((10000, 4)) if amplitude == 0.0 else voltages(10000, amplitude, seed, 5e-4)
    start = craft_state(
        attitude=generator.uniform(-1, 1, 3) * [1.0, 0.3, 2.0],
        rates=generator.uniform(-1, 1, 3) * [0.4, 0.2, 0.4],
        rotor_rev_s=rotors,
    )
    one = simulate(craft, start, voltage, period_s=5e-4)
    other = simulate(craft, start, voltage, period_s=5e-4, model=BodyModel.EULER_LAGRANGE)
    pitch = np.degrees(np.abs(attitude_of(one)[:, 1])).max()
    assert pitch < 80
    turned = np.sign((one[:, QUATERNION] * other[:, QUATERNION]).sum(-1))
    other[:, QUATERNION] *= turned[:, None]  # q and -q are one attitude
    np.testing.assert_allclose(other[:, QUATERNION], one[:, QUATERNION], atol=1e-8)
    np.testing.assert_allclose(other[:, RATE], one[:, RATE], atol=1e-8)
    np.testing.assert_allclose(other[:, POSITION], one[:, POSITION], atol=1e-8)
    assert np.ptp(one[:, RATE], axis=0).min() > 1e-3


def test_they_also_agree_at_a_pitch_close_to_80_degrees():
    craft = craft_of_vehicle(CRAZYFLIE, gyroscopic=False)
    craft["inertia"] = 1.0e-5, 1.3e-5, 1.9e-5
    start = craft_state(attitude=(0.2, 1.33, 0.5), rates=(0.3, 0.05, 0.35))
    still = np.zeros((50000, 4))
    one = simulate(craft, start, still, period_s=1e-4)
    other = simulate(craft, start, still, period_s=1e-4, model=BodyModel.EULER_LAGRANGE)
    pitch = np.degrees(np.abs(attitude_of(one)[:, 1])).max()
    assert 75 < pitch < 80
    difference = np.abs(attitude_of(other) - attitude_of(one))
    assert np.minimum(difference, 2 * np.pi - difference).max() < 1e-8


def test_two_seconds_of_free_fall_reach_19_6_m_s():
    states = simulate(coasting(), craft_state(rates=(1.0, -2.0, 3.0)), np.zeros((1000, 4)))
    np.testing.assert_allclose(states[-1, VELOCITY], [0, 0, -2 * 9.80665], rtol=1e-12)
    np.testing.assert_allclose(states[-1, POSITION], [0, 0, -2 * 9.80665], rtol=1e-12)


def test_without_torque_energy_and_angular_momentum_stay():
    craft = coasting()
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
    craft = craft_of_vehicle(CRAZYFLIE, coupling=False, spin_up=False)
    craft["thrust"], craft["drag"] = 0.0, 0.0
    craft["gyroscopic"] *= 10
    craft["spin_up"] *= 10
    start = craft_state(rates=(3.0, -1.0, 2.0), rotor_rev_s=(300, 0, 300, 0))
    states = simulate(craft, start, np.zeros((500, 4)), substeps=32)
    energy = 0.5 * (states[:, RATE] ** 2 @ craft["inertia"][0])
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    assert np.ptp(states[:, 10]) > 1.0


def test_rotors_and_body_keep_their_total_angular_momentum_without_air():
    """Gyroscopic and spin-up torques together are the conservation of momentum about every axis."""
    craft = craft_of_vehicle(CRAZYFLIE)
    craft["thrust"], craft["drag"] = 0.0, 0.0
    craft["gyroscopic"] *= 10
    craft["spin_up"] *= 10
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


@pytest.mark.parametrize("model", list(BodyModel))
def test_halving_the_step_divides_the_error_by_sixteen(model):
    craft = craft_of_vehicle(CRAZYFLIE)
    start = craft_state(attitude=(0.4, 0.3, 0.2), rates=(2.0, -1.0, 3.0), rotor_rev_s=250)
    voltage = voltages(10, 40.0, period=0.04)

    def end(substeps):
        return simulate(craft, start, voltage, period_s=0.04, substeps=substeps, model=model)[-1]

    exact = end(256)
    errors = [np.linalg.norm(end(n) - exact) for n in (4, 8, 16)]
    np.testing.assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 16, rtol=0.25)


def test_the_simplified_model_agrees_for_small_angles_only():
    craft = craft_of_vehicle(CRAZYFLIE, coupling=False, gyroscopic=False, spin_up=False)
    wobble = voltages(250, 0.0)
    wobble[:25] += [0, -1, 0, 1]
    wobble[25:75] -= [0, -1, 0, 1]
    wobble[75:100] += [0, -1, 0, 1]
    level = craft_state(rotor_rev_s=CRAZYFLIE.motor.steady_rev_s(HOVER_MV))
    tilted = craft_state(
        attitude=(0.0, 0.6, 0.0),
        rotor_rev_s=CRAZYFLIE.motor.steady_rev_s(HOVER_MV),
        rates=(0, 0, 1),
    )
    gaps = []
    for start in (level, tilted):
        exact = attitude_of(simulate(craft, start, wobble))
        simple = attitude_of(simulate(craft, start, wobble, model=BodyModel.SIMPLIFIED))
        gaps.append(np.abs(exact - simple).max())
    assert gaps[0] < 1e-4
    assert gaps[1] > 1e-2


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
        other = craft_of_vehicle(vehicle, coupling=False, gyroscopic=False, spin_up=False)
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
    craft = craft_of_vehicle(CRAZYFLIE, coupling=False, gyroscopic=False)
    craft["gravity"] = 0.0
    push = np.tile([1.0, 2.0, 3.0, 0.1, 0.2, 0.3], (10, 1))
    for model in BodyModel:
        states = simulate(craft, craft_state(), np.zeros((10, 4)), disturbance=push, model=model)
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
