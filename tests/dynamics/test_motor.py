"""The motor against scipy's integrator, its steady state and its physical constants."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from groundstation.dynamics.simulation import armature_mv, simulate_motor
from groundstation.dynamics.vehicle import THESIS_MOTOR, MotorConstants


def test_the_thesis_motor_runs_at_355_rev_s_on_3700_mv():
    speed, _ = simulate_motor(THESIS_MOTOR, np.full((2000, 1), 3700.0), 0.002, [0.0])
    assert speed[-1, 0] == pytest.approx(354.8, abs=0.1)
    assert speed[-1, 0] == pytest.approx(THESIS_MOTOR.steady_rev_s(3700.0), rel=1e-6)


def test_speeds_agree_with_an_adaptive_integrator():
    generator = np.random.default_rng(3)
    voltage = generator.uniform(0, 4000, (50, 4))
    start = np.array([0.0, 100.0, 250.0, 400.0])
    motors = tuple(MotorConstants(0.7 + 0.1 * i, 5.0 + i, 0.004 * i) for i in range(4))
    speed, square = simulate_motor(motors, voltage, 0.002, start)
    for motor, m in enumerate(motors):
        n, total = start[motor], 0.0
        for k, volt in enumerate(voltage[:, motor]):
            solution = solve_ivp(
                lambda _, y, volt=volt, m=m: [
                    m.a0 * volt - m.a1 * y[0] - m.a2 * y[0] ** 2,
                    y[0] ** 2,
                ],
                (0, 0.002),
                [n, 0.0],
                rtol=1e-11,
                atol=1e-11,
            )
            n, total = solution.y[:, -1]
            assert speed[k + 1, motor] == pytest.approx(n, abs=1e-6)
            assert square[k, motor] == pytest.approx(total / 0.002, abs=1e-3)


def test_halving_the_step_divides_the_error_by_sixteen():
    voltage = np.array([[4000.0], [500.0]])

    def after(substeps):
        return simulate_motor(THESIS_MOTOR, voltage, 0.2, [50.0], substeps)[0][-1, 0]

    exact = after(512)
    ratios = [(after(n) - exact) / (after(2 * n) - exact) for n in (8, 16)]
    np.testing.assert_allclose(ratios, 16, rtol=0.2)


def test_without_an_initial_speed_the_motor_is_settled():
    speed, square = simulate_motor(THESIS_MOTOR, np.full((10, 2), 2000.0), 0.002)
    np.testing.assert_allclose(speed, THESIS_MOTOR.steady_rev_s(2000.0), rtol=1e-12)
    np.testing.assert_allclose(square, speed[0, 0] ** 2, rtol=1e-12)


def test_voltages_without_rows_are_refused():
    with pytest.raises(ValueError, match="expected"):
        simulate_motor(THESIS_MOTOR, np.zeros((0, 4)), 0.002)


def test_armature_voltage_is_duty_times_supply_in_mv():
    np.testing.assert_allclose(
        armature_mv([[0.5, 1.0], [0.25, 0]], [4.0, 3.6]), [[2000, 4000], [900, 0]]
    )
