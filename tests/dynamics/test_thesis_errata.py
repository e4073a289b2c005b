"""What the thesis prints against what follows from its own definitions: docs/thesis_errata.md.

Each test is named after the equation. Lagrange's equations are derived here from the kinetic
energy alone; the printed right-hand sides are typed in as they stand.
"""

import functools

import numpy as np
import pytest
import sympy as sp
from scipy.signal import lfilter

from groundstation.dynamics.craft import craft_of_vehicle
from groundstation.dynamics.model import THESIS, ArxAxis, poles
from groundstation.dynamics.rotations import rotation_matrix
from groundstation.dynamics.simulation import RATE, craft_state, simulate
from groundstation.dynamics.vehicle import BUILT_IN

T = sp.Symbol("t")
PHI, THETA, PSI = (sp.Function(name)(T) for name in ("phi", "theta", "psi"))
ETA = sp.Matrix([PHI, THETA, PSI])
RATES = ETA.diff(T)
IXX, IYY, IZZ, MASS, G = sp.symbols("Ixx Iyy Izz m g", positive=True)
U1, U2, U3 = sp.symbols("U1 U2 U3")
INERTIA = sp.diag(IXX, IYY, IZZ)
S, C = sp.sin, sp.cos


def euler_rotation():
    """Rz Ry Rx of eq. 3.3-3.5."""
    rx = sp.Matrix([[1, 0, 0], [0, C(PHI), -S(PHI)], [0, S(PHI), C(PHI)]])
    ry = sp.Matrix([[C(THETA), 0, S(THETA)], [0, 1, 0], [-S(THETA), 0, C(THETA)]])
    rz = sp.Matrix([[C(PSI), -S(PSI), 0], [S(PSI), C(PSI), 0], [0, 0, 1]])
    return rz * ry * rx


@functools.cache
def body_rates():
    """Omega of R' = R [Omega x]."""
    rotation = euler_rotation()
    skew = (rotation.T * rotation.diff(T)).applyfunc(sp.expand).applyfunc(sp.trigsimp)
    return sp.Matrix([skew[2, 1], skew[0, 2], skew[1, 0]])


@functools.cache
def rates_matrix():
    """W of eq. 3.10 from the body's rates, not from print."""
    return sp.simplify(body_rates().jacobian(RATES))


@functools.cache
def kinetic_matrix():
    w = rates_matrix()
    return sp.simplify(w.T * INERTIA * w)


@functools.cache
def lagrange_left_side():
    """The generalised torque of Lagrange's equations from the kinetic energy."""
    energy = (RATES.T * kinetic_matrix() * RATES)[0] / 2
    pairs = zip(ETA, RATES, strict=True)
    return sp.Matrix([energy.diff(v).diff(T) - energy.diff(x) for x, v in pairs])


@functools.cache
def lagrange_right_side():
    """J eta'' = tau - (what Lagrange's equations leave), for a generalised torque (U1, U2, U3)."""
    return sp.Matrix([U1, U2, U3]) - (lagrange_left_side() - kinetic_matrix() * ETA.diff(T, 2))


def assert_equal(one, other):
    assert sp.simplify((sp.Matrix([one]) - sp.Matrix([other])).expand(trig=True)).is_zero_matrix


def test_3_6_and_3_10_follow_from_the_elementary_rotations():
    np.testing.assert_allclose(
        np.array(euler_rotation().subs({PHI: 0.3, THETA: -0.4, PSI: 1.1}), float),
        rotation_matrix([0.3, -0.4, 1.1]),
        atol=1e-15,
    )
    printed = sp.Matrix(
        [
            [1, 0, -S(THETA)],
            [0, C(PHI), C(THETA) * S(PHI)],
            [0, -S(PHI), C(THETA) * C(PHI)],
        ]
    )
    assert_equal(rates_matrix(), printed)


def test_3_2_and_3_22_print_the_reverse_of_the_order_that_3_9_uses():
    """W times (psi', theta', phi') is not the body rate; times (phi', theta', psi') it is."""
    omega = body_rates()
    as_used = rates_matrix() * RATES
    as_printed = rates_matrix() * sp.Matrix([RATES[2], RATES[1], RATES[0]])
    assert_equal(omega, as_used)
    assert sp.simplify(omega - as_printed) != sp.zeros(3, 1)


def test_3_15_3_16_and_3_21_need_the_lever_arm_to_be_torques():
    """Units: a difference of two forces is not a torque. With the arm 3.53 gives rad/s^2."""
    newton, metre, kilogram, second = sp.symbols("N m kg s", positive=True)
    as_base = {newton: kilogram * metre / second**2}
    inertia = kilogram * metre**2
    printed = (newton / inertia).subs(as_base)
    with_arm = (newton * metre / inertia).subs(as_base)
    assert sp.simplify(printed * second**2) != 1
    assert sp.simplify(with_arm * second**2) == 1


def test_3_17_is_a_force_a_torque_needs_the_radius_cubed():
    """Density, area, radius squared, angular rate squared are newtons; b of 3.18 is a torque's."""
    metre, kilogram, second = sp.symbols("m kg s", positive=True)
    newton = kilogram * metre / second**2
    density, area, rate = kilogram / metre**3, metre**2, 1 / second
    assert sp.simplify(density * area * metre**2 * rate**2 / newton) == 1
    assert sp.simplify(density * area * metre**3 * rate**2 / (newton * metre)) == 1


def test_3_32_has_the_sign_of_gravity_wrong():
    """Lagrange's equation of the printed energies gives F = m zeta'' + m g e_z, and so 3.35."""
    z = sp.Function("z")(T)
    lagrangian = MASS * z.diff(T) ** 2 / 2 - MASS * G * z
    force = lagrangian.diff(z.diff(T)).diff(T) - lagrangian.diff(z)
    assert sp.simplify(force - (MASS * z.diff(T, 2) + MASS * G)) == 0
    assert sp.simplify(force - (MASS * z.diff(T, 2) - MASS * G)) != 0


def test_3_38_is_right_as_printed():
    difference = IYY - IZZ
    corner = -IXX * S(THETA)
    side = difference * C(THETA) * C(PHI) * S(PHI)
    printed = sp.Matrix(
        [
            [IXX, 0, corner],
            [0, IYY * C(PHI) ** 2 + IZZ * S(PHI) ** 2, side],
            [
                corner,
                side,
                IXX * S(THETA) ** 2 + C(THETA) ** 2 * (IZZ * C(PHI) ** 2 + IYY * S(PHI) ** 2),
            ],
        ]
    )
    assert_equal(kinetic_matrix(), printed)


def printed_3_46():
    df, dt, ds = RATES
    first = (
        U1
        + (-IYY + IZZ) * C(PHI) * S(PHI) * dt**2
        + C(THETA) * (IXX + (IYY - IZZ) * C(2 * PHI)) * dt * ds
        + (IYY - IZZ) * C(THETA) ** 2 * C(PHI) * S(PHI) * ds**2
    )
    second = (
        U2
        + (IYY - IZZ) * S(2 * PHI) * dt * df
        + C(THETA)
        * ds
        * (
            -(IXX + (IYY - IZZ) * C(2 * PHI)) * df
            + S(THETA) * (IXX - IZZ * C(PHI) ** 2 - IYY * S(PHI) ** 2) * ds
        )
    )
    third = U3 + sp.Rational(1, 2) * (
        (IYY - IZZ) * S(THETA) * S(2 * PHI) * dt**2
        + 2 * (-IYY + IZZ) * C(THETA) ** 2 * S(2 * PHI) * df * ds
        + 2
        * C(THETA)
        * dt
        * (
            (IXX + (-IYY + IZZ) * C(2 * PHI)) * df
            + (-2 * IXX + IYY + IZZ + (-IYY + IZZ) * C(2 * PHI)) * S(THETA) * ds
        )
    )
    return sp.Matrix([first, second, third])


def test_3_46_is_right_as_printed():
    assert_equal(lagrange_right_side(), printed_3_46())


def test_3_48_is_right_as_printed():
    df, dt, ds = RATES
    printed = sp.Matrix(
        [
            U1
            + IXX
            * S(PHI)
            * (C(PHI) * dt**2 + 2 * C(THETA) * S(PHI) * dt * ds - C(THETA) ** 2 * C(PHI) * ds**2),
            U2
            - IXX
            * (
                S(2 * PHI) * dt * df
                + C(THETA) * ds * (2 * S(PHI) ** 2 * df + C(PHI) ** 2 * S(THETA) * ds)
            ),
            U3
            - IXX * C(PHI) * S(THETA) * S(PHI) * dt**2
            + IXX * C(THETA) ** 2 * S(2 * PHI) * df * ds
            + 2 * IXX * C(THETA) * C(PHI) ** 2 * dt * (df + S(THETA) * ds),
        ]
    )
    assert_equal(lagrange_right_side().subs({IYY: IXX, IZZ: 2 * IXX}), printed)


def test_3_41_the_generalised_torque_is_w_transposed_times_the_body_torque():
    """Euler's equations times W^T are Lagrange's equations only with tau = W^T tau_B."""
    w = rates_matrix()
    omega = w * RATES
    body_torque = INERTIA * omega.diff(T) + omega.cross(INERTIA * omega)
    generalised = lagrange_left_side()
    numbers = {IXX: 1.0, IYY: 1.3, IZZ: 1.9}
    motion = {PHI: 0.4 + 0.7 * T, THETA: -0.3 + 0.5 * T**2, PSI: 1.1 * T - 0.2 * T**3}

    def value(expression):
        return np.array(expression.subs(motion).doit().subs(numbers).subs(T, 0.6), float).ravel()

    np.testing.assert_allclose(value(generalised), value(w.T * body_torque), atol=1e-12)
    assert np.abs(value(generalised - body_torque)).max() > 0.1


@pytest.mark.parametrize(("rate", "axis", "sign"), [((0, 2, 0), 0, 1), ((2, 0, 0), 1, -1)])
def test_3_49_to_3_56_the_gyroscopic_terms_have_the_sign_of_the_other_spin(rate, axis, sign):
    """M1, M3 counter-clockwise: the rotors carry h = I_r (w1 - w2 + w3 - w4) along z.

    The momentum lost by the rotors as they are turned, -Omega x h, is derived here by numbers;
    3.51-3.52 print the opposite of it.
    """
    vehicle = BUILT_IN["crazyflie1"]
    speeds = np.array([200.0, 260.0, 200.0, 260.0]) * 2 * np.pi
    h = vehicle.rotor_inertia_kg_m2 * np.array([0, 0, speeds @ [1, -1, 1, -1]])
    torque = -np.cross(rate, h)
    omega = speeds @ [-1, 1, -1, 1]
    p, q, _ = rate
    printed = vehicle.rotor_inertia_kg_m2 * np.array([-q * omega, p * omega, 0])
    assert torque[axis] == pytest.approx(-printed[axis])
    assert np.sign(torque[axis]) == sign

    inertia = {"rotor_inertia_kg_m2": vehicle.rotor_inertia_kg_m2}
    craft = craft_of_vehicle(vehicle, {"rotor_gyroscopic_torque": inertia})
    craft["thrust"] = craft["drag"] = 0.0
    held = [vehicle.motor.armature_mv(speed / (2 * np.pi)) for speed in speeds]
    start = craft_state(rates=rate, rotor_rev_s=speeds / (2 * np.pi))
    states = simulate(craft, start, [held], period_s=1e-6)
    gained = (states[-1, RATE] - states[0, RATE]) / 1e-6 * vehicle.inertia_kg_m2
    assert gained[axis] == pytest.approx(torque[axis], rel=1e-3)


def test_3_69_means_the_cosine_of_x6():
    """With psi = x6 it is 3.33; as printed, psi is no state of 3.61-3.62."""
    x4, x5, x6, psi = sp.symbols("x4 x5 x6 psi")
    printed = C(x4) * C(psi) * S(x5) + S(x4) * S(x6)
    row = (euler_rotation() * sp.Matrix([0, 0, 1]))[0].subs({PHI: x4, THETA: x5, PSI: x6})
    assert sp.simplify(printed.subs(psi, x6) - row) == 0
    assert printed.free_symbols - {x4, x5, x6} == {psi}


def test_3_79_adds_a_force_coefficient_to_a_torque_coefficient():
    """With k_L = k + b, no torque of the motor at 3.7 V could keep a rotor at hover speed."""
    vehicle = BUILT_IN["crazyflie1"]
    hover = np.sqrt(9.80665 / 4 / vehicle.thrust_per_mass)
    torque_constant = vehicle.motor.a1 / vehicle.motor.a0 / 1000 / (2 * np.pi)  # k_T = k_M, bound
    drag_only = vehicle.drag_n_m * hover**2
    as_printed = (vehicle.drag_n_m + vehicle.thrust_n) * hover**2
    stall = torque_constant * 3.7 / vehicle.winding_ohm
    assert drag_only < stall < as_printed


def test_7_7_with_f_and_c_set_to_one_is_not_the_arx_model_of_7_9():
    """ARX has A under the input too: B/A u + 1/A w. With F = 1 the input is not filtered by A."""
    a, b = [1.0, -0.8], [0.0, 1.0]
    inputs = np.ones(50)
    arx = np.zeros(51)
    for t in range(50):
        arx[t + 1] = 0.8 * arx[t] + inputs[t - 1] * (t > 0)
    np.testing.assert_allclose(lfilter(b, a, inputs), arx[1:], atol=1e-12)
    assert np.abs(lfilter(b, [1.0], inputs) - arx[1:]).max() > 1


@pytest.mark.parametrize(("axis", "grey_box", "less"), [("roll", 0.0136, 22), ("yaw", 0.0005, 31)])
def test_7_18_is_larger_than_what_the_arx_models_say_of_the_same_craft(axis, grey_box, less):
    """An input's kick on the angle's second difference is c Ts^2, of a free body and of an ARX
    model with one input term alike, wherever its poles lie."""
    model = THESIS.arx[axis]
    assert 1 + sum(model.a) == pytest.approx(0.0, abs=0.003), "nearly a double integrator"
    c = model.b[0] / model.ts**2
    assert 100 * (1 - c / grey_box) == pytest.approx(less, abs=0.6)


def test_7_27_has_an_unstable_pole_where_a_free_body_has_a_double_one_at_one():
    first, second = poles(THESIS.arx["roll"])
    assert first.real == pytest.approx(1.0317, abs=1e-4)
    assert second.real == pytest.approx(0.9273, abs=1e-4)


def test_7_31_prints_too_few_digits_to_tell_whether_yaw_is_stable():
    """A(1) = 1 - 1.995 + 0.9949 = -0.0001; half a unit of the last digits is 0.00055."""
    largest = []
    for first in (-1.9955, -1.9945):
        for second in (0.99485, 0.99495):
            axis = ArxAxis(2, 1, 8, (first, second), (1.382e-9,), 0.002)
            largest.append(np.abs(poles(axis)).max())
    assert min(largest) < 1.0 < max(largest)


def test_8_1_prints_the_power_minus_one_for_a_difference():
    """K_I T_s / (z - 1) sums the error; K_I T_s / z^-1 = K_I T_s z would need the future."""
    z, period = sp.symbols("z T_s")
    step = z / (z - 1)
    integrated = sp.series(
        (period / (z - 1) * step).subs(z, 1 / sp.Symbol("d")), sp.Symbol("d"), 0, 5
    )
    assert integrated.removeO().coeff(sp.Symbol("d"), 4) == 4 * period
    as_printed = period / z**-1
    assert sp.degree(as_printed, z) == 1  # an advance: not causal
