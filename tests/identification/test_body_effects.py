"""Every effect that the body fit knows: found where the stand-in hides it, zero where not."""

import numpy as np
import pytest

from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR
from groundstation.errors import BadInputError
from groundstation.identification.body import fit_body
from groundstation.identification.body_setup import FITTED
from groundstation.identification.flight import stretches_of
from groundstation.identification.motor.workflow import undo_supply
from groundstation.identification.runs import runs_of
from support.flights import CARRYING_GAINS, recorded

VEHICLE = BUILT_IN["crazyflie1"]
CONSTANTS = np.array(VEHICLE.body_constants)
HIDDEN = {
    "dead_time": {"delay_s": 0.004},
    "gyro_low_pass": {"bandwidth_hz": 40.0},
    "imu_misalignment": {"roll_deg": 2.0, "pitch_deg": -3.0, "yaw_deg": 4.0},
    "rotor_gyroscopic_torque": {"rotor_inertia_kg_m2": 5e-8},
    "rotor_acceleration_torque": {"rotor_inertia_kg_m2": 5e-8},
    "inertia_coupling": {"fraction": 1.0},
    "rate_damping": {"damping_n_m_s": 1e-5},
    "quadratic_rate_damping": {"damping_n_m_s2": 1.5e-5},
    "yaw_damping": {"damping_n_m_s": 4e-6},
    "centre_of_gravity_offset": {"x_m": 0.001, "y_m": -0.0005},
    "rotor_mismatch": {"rotor": 3.0, "excess": 0.05},
    "velocity_moment": {"moment": 10.0},
    "motor_dead_voltage": {"voltage_mv": 200.0},
    "motor_braking_asymmetry": {"factor": 0.6},
    "motor_coasting": {"share": 0.7},
}


def flown(seed, seconds=30.0, **settings):
    samples, _ = recorded(seconds, plant="reduced", seed=seed, gains=CARRYING_GAINS, **settings)
    return stretches_of(runs_of(samples, f"flight {seed}"), THESIS_MOTOR)


@pytest.mark.parametrize(
    ("effect", "why"),
    [("slung_load", "length_m has to be looked for"), ("wind", "no fit of constants shows it")],
)
def test_an_effect_that_no_fit_shows_is_left_to_the_search(effect, why):
    with pytest.raises(BadInputError, match=why):
        fit_body([], VEHICLE, (effect,))


def test_every_effect_that_is_fitted_is_tested_here():
    assert set(HIDDEN) == set(FITTED)


@pytest.mark.parametrize("effect", HIDDEN)
def test_a_hidden_effect_is_found_within_its_uncertainty_and_the_constants_stay_right(effect):
    fit = fit_body(flown(5, effects={effect: HIDDEN[effect]}), VEHICLE, (effect,))
    found = fit.estimates
    for parameter, value in HIDDEN[effect].items():
        if parameter == "rotor":
            assert fit.setup.variants[0][0].choice == value
            continue
        name = f"{effect}.{parameter}"
        assert abs(found[name] - value) < 3.5 * found.error_of(name)
        assert found.error_of(name) < 0.3 * abs(value)  # and it is really seen
    constants = np.array([found[name] for name in ("c0", "c1", "c2")])
    assert np.abs(constants / CONSTANTS - 1).max() < 0.03


def test_on_clean_data_every_effect_is_zero_within_its_uncertainty():
    """All torques fitted together, and other effects each alone."""
    stretches = flown(6, torque_noise=6.0)
    alone = ("dead_time", "imu_misalignment", "rotor_mismatch", "motor_dead_voltage")
    together = tuple(
        name for name in FITTED if name not in (*alone, "gyro_low_pass", "motor_braking_asymmetry")
    )
    for effects in (together, *[(name,) for name in alone]):
        fit = fit_body(stretches, VEHICLE, effects)
        for name, value in fit.estimates.of_effects.items():
            assert abs(value) < 4.0 * fit.estimates.error_of(name), name


def test_a_low_pass_that_is_not_there_has_no_lag_and_braking_is_symmetric():
    stretches = flown(7)
    fit = fit_body(stretches, VEHICLE, ("gyro_low_pass", "motor_braking_asymmetry"))
    assert fit.estimates["gyro_low_pass.bandwidth_hz"] > 800.0
    name = "motor_braking_asymmetry.factor"
    assert abs(fit.estimates[name] - 1.0) < 4.0 * fit.estimates.error_of(name)


def test_two_effects_that_look_alike_are_called_so_with_what_separates_them():
    fit = fit_body(flown(8), VEHICLE, ("dead_time", "gyro_low_pass"))
    told = [text for text in fit.warnings if "told only together" in text]
    assert len(told) == 1
    assert "dead_time.delay_s" in told[0]
    assert "a low-pass lags the gyro alone" in told[0] or "moves the attitude" in told[0]


def test_an_implausible_effect_is_called_so():
    """Negative damping: what a fit finds when it is asked for an effect that is not there."""
    flight = flown(9, effects={"yaw_damping": {"damping_n_m_s": -2e-5}})
    fit = fit_body(flight, VEHICLE, ("yaw_damping",))
    assert any("outside the plausible" in text for text in fit.warnings)


def test_supply_loss_and_a_lagging_report_bias_every_constant_and_can_be_undone():
    """Faithful plant: 3 % for the issue, 0.8 % with everything that is there fitted along."""
    samples, _ = recorded(50.0, plant="faithful", seed=23)
    runs = runs_of(samples)
    turning = "rotor_gyroscopic_torque", "rotor_acceleration_torque"
    present = ("dead_time", "inertia_coupling", *turning)
    plain = fit_body(stretches_of(runs, THESIS_MOTOR), VEHICLE, present)
    supplied = ("battery_reading_lag", "supply_sag")
    undone, (supply,) = undo_supply(runs, THESIS_MOTOR, VEHICLE, supplied)
    fit = fit_body(stretches_of(undone, THESIS_MOTOR), VEHICLE, present)
    errors = [
        np.array([one.body.c0, one.body.c1, one.body.c2]) / CONSTANTS - 1 for one in (plain, fit)
    ]
    assert np.all((errors[0] < -0.012) & (errors[0] > -0.03))
    assert np.abs(errors[1]).max() < 0.008
    assert fit.body.thrust_per_mass == pytest.approx(VEHICLE.thrust_per_mass, rel=0.001)
    assert supply.lag_s == pytest.approx(0.155, abs=0.02)
    assert supply.lag_stderr_s < 0.01
    inside = fit.estimates.interval(0.99)
    for name, true in (
        *zip(("c0", "c1", "c2"), CONSTANTS, strict=True),
        ("rotor_acceleration_torque.rotor_inertia_kg_m2", VEHICLE.rotor_inertia_kg_m2),
        ("rotor_gyroscopic_torque.rotor_inertia_kg_m2", VEHICLE.rotor_inertia_kg_m2),
        ("inertia_coupling.fraction", 1.0),
    ):
        low, high = inside[fit.estimates.names.index(name)]
        assert low <= true <= high, name


def test_what_is_left_of_a_faithful_flight_is_white():
    from groundstation.identification.body import prediction_residuals
    from groundstation.identification.estimate import whiteness_test

    samples, _ = recorded(36.0, plant="faithful", seed=22, sensor={"shake": (0.0, 0.0, 0.0)})
    stretches = stretches_of(runs_of(samples), THESIS_MOTOR)
    fit = fit_body(stretches, VEHICLE, ("dead_time", "rotor_acceleration_torque"))
    left = prediction_residuals(stretches[0], fit)
    assert [whiteness_test(one[np.isfinite(one)]).passes for one in left.T] == [True, True, True]


def test_the_motors_uncertainty_is_carried_into_the_constants():
    """Constants scale with the square of speed: a motor 1 % too fast makes them 2 % too small."""
    stretches = flown(10)
    exact = fit_body(stretches, VEHICLE)
    a0, a1, a2 = THESIS_MOTOR.a0, THESIS_MOTOR.a1, THESIS_MOTOR.a2
    # a0, a1, a2 all 1 % up together turn faster steps, not higher speed: only a0 alone does.
    doubtful = fit_body(stretches, VEHICLE, motor_covariance=np.diag([0.01 * a0, 0, 0]) ** 2)
    speed = 0.01 * a0 * _steady_slope(a0, a1, a2)
    share = doubtful.estimates.stderr / exact.estimates.values
    np.testing.assert_allclose(share[[2, 3]], 2 * speed, rtol=0.15)
    assert doubtful.estimates.correlation[0, 3] > 0.8
    assert np.all(doubtful.estimates.stderr[:4] > 1.4 * exact.estimates.stderr[:4])
    np.testing.assert_allclose(doubtful.estimates.values, exact.estimates.values)
    assert not any("told only together" in text for text in doubtful.warnings)


def _steady_slope(a0, a1, a2, voltage_mv=2300.0):
    """d ln(n) / d a0 of a settled motor."""
    n = (np.sqrt(a1**2 + 4 * a2 * a0 * voltage_mv) - a1) / (2 * a2)
    return voltage_mv / (a1 + 2 * a2 * n) / n
