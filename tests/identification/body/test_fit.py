"""The body fit on closed-loop flights of the stand-in, reduced and faithful."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.registry import DELAY
from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR
from groundstation.errors import BadInputError
from groundstation.identification.body import (
    fit_body,
    likeliest_that_turns,
    predicted_rates,
    prediction_residuals,
    validate_body,
)
from groundstation.identification.body_setup import on_other
from groundstation.identification.flight import divided, stretches_of
from groundstation.identification.runs import runs_of
from support.flights import recorded

VEHICLE = BUILT_IN["crazyflie1"]
TRUE = np.array([*VEHICLE.body_constants, VEHICLE.thrust_per_mass])
NAMES = ("c0", "c1", "c2", "thrust_per_mass")
TURNING = ("inertia_coupling", "rotor_gyroscopic_torque", "rotor_acceleration_torque")
DLPF_LAG_S = 1 / (2 * np.pi * 188)


def flight(seed, plant="reduced", seconds=66.0, **settings):
    samples, truth = recorded(seconds, plant=plant, seed=seed, **settings)
    return runs_of(samples, f"flight {seed}"), truth


@pytest.fixture(scope="module")
def reduced():
    return flight(21)[0]


@pytest.fixture(scope="module")
def fitted(reduced):
    return fit_body(stretches_of(reduced, THESIS_MOTOR), VEHICLE)


@pytest.fixture(scope="module")
def faithful():
    return flight(22, "faithful")


@pytest.fixture(scope="module")
def fitted_along(faithful):
    effects = ("dead_time", "rotor_acceleration_torque")
    return fit_body(stretches_of(faithful[0], THESIS_MOTOR), VEHICLE, effects)


def values(fit):
    return np.array([fit.estimates[name] for name in NAMES])


def test_on_the_reduced_plant_the_constants_are_found_and_the_intervals_honest():
    """Three flights here; 50 in bench/identification.py."""
    errors, inside = [], []
    for seed in range(3):
        fit = fit_body(stretches_of(flight(seed)[0], THESIS_MOTOR), VEHICLE)
        interval = fit.estimates.interval(0.99)
        errors.append(values(fit) / TRUE - 1)
        inside.append((interval[:, 0] <= TRUE) & (interval[:, 1] >= TRUE))
        assert not fit.warnings
    assert np.abs(errors).max() < 0.03
    assert np.abs(np.mean(errors, axis=0)).max() < 0.005
    assert np.sum(~np.array(inside)) <= 1


def test_no_fit_in_which_rotors_turn_nothing_is_taken_before_one_in_which_they_do(fitted):
    setup, whole = fitted.setup, fitted.free
    still = replace(whole, point={**whole.point, "c1": 1e-3 * TRUE[1]}, cost=whole.cost - 300.0)
    assert likeliest_that_turns(setup, [still, whole]) is whole
    assert likeliest_that_turns(setup, [replace(whole, cost=whole.cost + 1.0), whole]) is whole
    assert likeliest_that_turns(setup, [still]) is still  # which is refused, with its reason


def test_on_the_faithful_plant_they_are_within_3_percent_once_known_effects_are_fitted_along(
    faithful, fitted_along
):
    fit = fitted_along
    assert np.abs(values(fit) / TRUE - 1).max() < 0.03
    plain = fit_body(stretches_of(faithful[0], THESIS_MOTOR), VEHICLE)
    assert np.abs(values(plain) / TRUE - 1).max() < 0.03  # nuisances stand in for both
    assert plain.effects == ()
    for effect in ("dead_time", "rotor_acceleration_torque"):
        assert effect in plain.shown
        assert effect not in fit.shown
    assert plain.delay_s > 0.0  # fitted along
    assert plain.saved[DELAY] == 0.0  # and not in what is saved
    assert plain.saved["c0"] == plain.body.c0
    assert fit.saved[DELAY] == fit.delay_s


def test_the_sensor_delay_is_found_within_a_sample(faithful, fitted_along):
    _, truth = faithful
    true = truth["sensor_age_s"][3000:].mean() + DLPF_LAG_S
    assert fitted_along.delay_s == pytest.approx(true, abs=0.001)
    assert fitted_along.estimates.error_of("dead_time.delay_s") < 1e-4


def test_a_longer_delay_is_found_too():
    """The thesis's 8 samples, on a craft with gains low enough to bear it."""
    gains = {"pid_rate.roll_kp": 40.0, "pid_rate.pitch_kp": 40.0}
    runs, truth = flight(31, "faithful", 40.0, sensor={"delay_s": 0.010}, gains=gains)
    stretches = stretches_of(runs, THESIS_MOTOR)
    fit = fit_body(stretches, VEHICLE, ("dead_time", "rotor_acceleration_torque"))
    true = truth["sensor_age_s"][3000:].mean() + DLPF_LAG_S
    assert true > 0.008
    assert fit.delay_s == pytest.approx(true, abs=0.002)


def test_without_a_delay_none_is_found(reduced):
    fit = fit_body(stretches_of(reduced, THESIS_MOTOR), VEHICLE, ("dead_time",))
    assert fit.delay_s < 2e-4


def test_rigid_body_and_rotor_effects_can_be_fitted_along(faithful):
    runs, _ = faithful
    found = fit_body(stretches_of(runs, THESIS_MOTOR), VEHICLE, ("dead_time", *TURNING)).estimates
    inertia = VEHICLE.rotor_inertia_kg_m2
    spinning, tilting = (
        f"rotor_{of}_torque.rotor_inertia_kg_m2" for of in ("acceleration", "gyroscopic")
    )
    assert found[spinning] == pytest.approx(inertia, rel=0.05)
    for name, true in ((tilting, inertia), ("inertia_coupling.fraction", 1.0)):
        assert abs(found[name] - true) < 4 * found.error_of(name)


def test_effects_that_are_not_there_come_out_as_zero(reduced):
    found = fit_body(stretches_of(reduced, THESIS_MOTOR), VEHICLE, TURNING).estimates
    for name, size in found.of_effects.items():
        assert abs(size) < 4 * found.error_of(name), name


def test_roll_and_pitch_can_be_tied(reduced, fitted):
    tied, free = fit_body(stretches_of(reduced, THESIS_MOTOR), VEHICLE, tie_roll_pitch=True), fitted
    assert tied.body.c0 == tied.body.c1
    assert min(free.body.c0, free.body.c1) <= tied.body.c0 <= max(free.body.c0, free.body.c1)
    assert tied.estimates.stderr[0] < free.estimates.stderr[0]


def test_several_recordings_fit_together(reduced, fitted):
    other = flight(23)[0]
    both = fit_body(stretches_of([*reduced, *other], THESIS_MOTOR), VEHICLE)
    assert np.all(both.estimates.stderr < 0.85 * fitted.estimates.stderr)


def test_held_out_rates_are_predicted_as_well_as_by_the_true_constants(reduced):
    fit_on, held, _ = divided(stretches_of(reduced, THESIS_MOTOR), "plus")
    fit = fit_body(fit_on, VEHICLE)
    true = dict(zip(NAMES[:3], TRUE, strict=False))
    true = replace(fit, free=replace(fit.free, point={**fit.point, **true}))
    ours = validate_body(held, fit)
    best = validate_body(held, true)
    for name in ours:
        if name.startswith("gyro") and "rms" in name:
            assert ours[name] < 1.01 * best[name]
    assert ours["accelerometer_z_rms"] < 0.03
    assert ours["accelerometer_z_fit_percent"] > 85
    assert ours["gyro_roll_rms_1row"] < ours["gyro_roll_rms_20ms"] < ours["gyro_roll_rms_50ms"]


def prediction_errors(fit, stretches, values, horizon_s):
    """RMS errors (3,) in rad/s of rates predicted with some values of a fit replaced."""
    pairs = predicted_rates(fit, on_other(fit.setup, stretches), {**fit.point, **values}, horizon_s)
    errors = np.vstack([measured - predicted for measured, predicted in pairs])
    return np.sqrt(np.mean(np.square(errors), axis=0))


def test_a_wrong_constant_predicts_worse_at_the_longer_horizon(reduced, fitted):
    stretches = stretches_of(reduced, THESIS_MOTOR)
    right, worse = (
        prediction_errors(fitted, stretches, {"c0": factor * fitted.body.c0}, 0.05)
        for factor in (1.0, 1.5)
    )
    assert worse[0] > 1.5 * right[0]
    np.testing.assert_allclose(worse[1:], right[1:], rtol=1e-3)


def test_a_gap_splits_a_flight_and_the_fit_stays_good():
    samples, _ = recorded(66.0, plant="reduced", seed=24)
    keep = np.ones(len(samples), bool)
    keep[14000:14060] = keep[21000:21001] = False
    runs = runs_of(samples[keep], "torn")
    stretches = stretches_of(runs, THESIS_MOTOR)
    assert len(stretches) == 3
    fit = fit_body(stretches, VEHICLE)
    assert np.abs(values(fit) / TRUE - 1).max() < 0.01


def test_a_hover_says_which_axis_it_hardly_moves(fitted):
    (run,) = flight(25, seconds=14.0, program="hover", sensor_noise=0.2)[0]
    fit = fit_body(stretches_of([run], THESIS_MOTOR), VEHICLE)
    assert fit.estimates.stderr[2] > 5 * fitted.estimates.stderr[2]
    assert any("is hardly excited" in text and "uncertain by" in text for text in fit.warnings)


def test_another_configuration_is_refused(reduced, fitted):
    """Read as an X craft, torques come out on the wrong axes."""
    turned = msgspec.structs.replace(VEHICLE, configuration="x")
    with pytest.raises(BadInputError, match="do not sit in configuration 'x'"):
        fit_body(stretches_of(reduced, THESIS_MOTOR), turned)
    assert not fitted.warnings


def test_a_constant_rate_is_refused(reduced):
    (run,) = reduced
    gyro = run.gyro.copy()
    gyro[:, 2] = 0.0
    with pytest.raises(BadInputError, match="about yaw is constant"):
        fit_body(stretches_of([replace(run, gyro=gyro)], THESIS_MOTOR), VEHICLE)


def test_a_stretch_shorter_than_the_whitener_has_no_residuals_to_test(reduced, fitted):
    whole = stretches_of(reduced, THESIS_MOTOR)[0]
    short = replace(whole, last=whole.first + 100)
    assert np.isnan(prediction_residuals(short, fitted)).all()
    assert np.isfinite(prediction_residuals(whole, fitted)[-100:]).all()
