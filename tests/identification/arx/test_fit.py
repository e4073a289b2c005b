"""ARX search, on made data with a known answer and on the stand-in's flights."""

import numpy as np
import pytest

from groundstation.dynamics.model import THESIS, ArxAxis, simulate_arx, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR
from groundstation.errors import BadInputError
from groundstation.identification.arx import (
    ArxData,
    Criterion,
    arx_data,
    arx_estimates,
    free_run_rms,
    identify_arx,
    input_shows,
    plausible_step,
    prediction_rms,
    residuals,
    search_arx,
)
from groundstation.identification.estimate import cross_correlation_test, whiteness_test
from groundstation.identification.flight import hold_out, turning
from groundstation.identification.likelihood.kernels import steps_ahead
from groundstation.identification.runs import runs_of
from support.flights import recorded

MODEL = vehicle_model(BUILT_IN["crazyflie1"])
TRUE = ArxAxis(2, 1, 3, (-1.95, 0.9503), (2e-7,), 0.002)
"""A slow and a fast real pole, delay of three rows."""


def made(axis, rows=6000, noise=1e-4, seed=0):
    """Data of eq. 7.9: the noise goes through 1/A, as the model says."""
    generator = np.random.default_rng(seed)
    inputs = np.repeat(generator.uniform(-2e4, 2e4, rows // 40 + 1), 40)[:rows]
    clean = simulate_arx(axis, inputs)
    shaken = simulate_arx(
        ArxAxis(axis.na, 1, 0, axis.a, (1.0,), axis.ts), generator.normal(0, noise, rows)
    )
    return ArxData(f"made {seed}", axis.ts, inputs, clean + shaken)


@pytest.fixture(scope="module")
def flights():
    """plant -> (to fit, held out) of a 60 s flight."""
    found = {}
    for plant in ("reduced", "faithful"):
        samples, _ = recorded(66.0, plant=plant, seed=11)
        (run,) = [part for whole in runs_of(samples) for part in whole.parts(turning(whole), 2.0)]
        found[plant] = hold_out([run])
    return found


def axis_data(runs, axis, **options):
    return [arx_data(run, axis, THESIS_MOTOR, **options) for run in runs]


def test_one_gram_matrix_gives_the_least_squares_of_every_structure():
    data = made(TRUE, rows=1500)
    search = search_arx([data], [data])
    assert len(search.candidates) == 88
    longest = 12
    for candidate in search.candidates:
        axis = candidate.axis
        rows = np.arange(longest, 1500)
        regressors = np.column_stack(
            [-data.outputs[rows - i] for i in range(1, axis.na + 1)]
            + [data.inputs[rows - axis.nk - j] for j in range(axis.nb)]
        )
        scale = np.linalg.norm(regressors, axis=0)
        theta, left, *_ = np.linalg.lstsq(regressors / scale, data.outputs[rows], rcond=None)
        np.testing.assert_allclose([*axis.a, *axis.b], theta / scale, rtol=1e-4)
        assert candidate.rms_step == pytest.approx(np.sqrt(left[0] / len(rows)), rel=1e-4)
        spread = np.linalg.inv((regressors / scale).T @ (regressors / scale))
        variance = left[0] / (len(rows) - len(theta)) * np.diag(spread)
        np.testing.assert_allclose(candidate.stderr, np.sqrt(variance) / scale, rtol=1e-3)


@pytest.mark.parametrize("criterion", list(Criterion))
def test_the_true_structure_is_chosen_and_no_larger_one(criterion):
    one, other, held = (made(TRUE, seed=seed, noise=2e-5) for seed in (1, 2, 3))
    search = search_arx([one, other], [held], criterion=criterion)
    chosen = search.chosen.axis
    assert (chosen.na, chosen.nb) == (2, 1)
    if criterion is Criterion.PREDICTION:
        larger = [one for one in search.candidates if one.axis.na > 2]
        assert min(one.rms_step for one in larger) < search.chosen.rms_step  # and still lose
        assert chosen.nk == 3
        theta, truth = [*chosen.a, *chosen.b], [*TRUE.a, *TRUE.b]
        assert np.all(np.abs(np.subtract(theta, truth)) < 4 * search.chosen.stderr)


def test_the_residuals_of_the_true_structure_pass_and_of_a_wrong_delay_do_not():
    fit, held = made(TRUE, seed=1), made(TRUE, seed=4)
    right = search_arx([fit], [held], [2], [1], [3]).chosen.axis
    wrong = search_arx([fit], [held], [2], [1], [8]).chosen.axis
    for axis, passes in ((right, True), (wrong, False)):
        left = residuals(axis, held)
        assert whiteness_test(left).passes is passes
        assert cross_correlation_test(left, held.inputs[-len(left) :]).passes is passes


def test_free_runs_restart_from_measured_outputs_so_that_an_unstable_plant_can_be_judged():
    axis = THESIS.arx["roll"]
    generator = np.random.default_rng(0)
    rows = 4000
    inputs = generator.normal(0, 1e3, rows)
    outputs = np.zeros(rows)
    for t in range(10, rows):  # a crude loop keeps it bounded
        inputs[t - 8] -= 3e5 * outputs[t - 1] + 2e7 * (outputs[t - 1] - outputs[t - 2])
        outputs[t] = 1.959 * outputs[t - 1] - 0.9567 * outputs[t - 2]
        outputs[t] += 4.222e-8 * inputs[t - 8] + generator.normal(0, 1e-5)
        outputs[t] = np.clip(outputs[t], -0.5, 0.5)
    data = ArxData("loop", 0.002, inputs, outputs)
    short = free_run_rms(axis, [data], window_s=0.1)
    long = free_run_rms(axis, [data], window_s=8.0)
    assert short < 0.1 < 1e3 < long


def test_errors_grow_with_the_horizon():
    data = made(TRUE, seed=5)
    errors = [prediction_rms(TRUE, [data], steps) for steps in (1, 5, 10, 25)]
    assert errors == sorted(errors)
    assert errors[0] == pytest.approx(1e-4, rel=0.05)


def test_predictions_ahead_are_free_runs_from_the_past():
    data = made(TRUE, rows=400)
    a, b = np.array([*TRUE.a, 0, 0]), np.array(TRUE.b)
    predicted = np.zeros(400)
    steps_ahead(a, b, TRUE.nk, data.inputs, data.outputs, 10, 4, predicted)
    for t in (13, 70, 399):
        start = t - 9
        past = data.outputs[start - 2 : start]
        y1, y2 = past[1], past[0]
        for k in range(start, t + 1):
            y = -TRUE.a[0] * y1 - TRUE.a[1] * y2 + TRUE.b[0] * data.inputs[k - 3]
            y1, y2 = y, y1
        assert predicted[t] == pytest.approx(y1, rel=1e-12)


def test_on_the_gyro_the_chosen_model_leaves_white_residuals_and_no_delay(flights):
    """Reduced plant: p' = c0 u' without delay; na = 2 stands for the gyro's noise."""
    fit, held = (axis_data(runs, "roll", channel="gyro") for runs in flights["reduced"])
    search = search_arx(fit, held, criterion=Criterion.PREDICTION)
    chosen = search.chosen.axis
    left = residuals(chosen, held[0])
    assert whiteness_test(left).passes
    assert cross_correlation_test(left, held[0].inputs[-len(left) :]).passes
    assert chosen.nk == 0
    assert chosen.na + chosen.nb <= 4
    gain = sum(chosen.b) / -sum(k * a for k, a in enumerate(chosen.a, 1)) / chosen.ts
    c0 = BUILT_IN["crazyflie1"].body_constants[0]
    assert abs(gain) == pytest.approx(c0, rel=0.1)


def test_on_the_held_angle_least_squares_misjudges_the_delay(flights):
    """True delay 3.3 ms: two rows. The angle is held for two rows and rounded to 0.01 deg."""
    fit, held = (axis_data(runs, "roll") for runs in flights["faithful"])
    search = search_arx(fit, held, [2], [1])
    one_step = min(search.candidates, key=lambda c: c.rms_step)
    assert one_step.axis.nk >= 5


def test_a_roll_model_serves_pitch_as_well(flights):
    fit, held = flights["reduced"]
    rolled, pitched = (axis_data(held, axis, channel="gyro") for axis in ("roll", "pitch"))
    chosen = search_arx(axis_data(fit, "roll", channel="gyro"), rolled, [2], [1]).chosen.axis
    assert free_run_rms(chosen, pitched, 0.1) < 1.3 * free_run_rms(chosen, rolled, 0.1)


def test_coefficients_come_with_a_covariance_that_holds():
    """Over 30 noises: the spread of the coefficients is what the covariance says."""
    found, errors = [], []
    for seed in range(30):
        data = made(TRUE, rows=2000, seed=seed, noise=2e-5)
        axis = search_arx([data], [data], [2], [1], [3]).chosen.axis
        estimates = arx_estimates(axis, [data])
        assert estimates.names == ("a1", "a2", "b1")
        found.append(estimates.values)
        errors.append(estimates.stderr)
    spread = np.std(found, axis=0)
    np.testing.assert_allclose(np.mean(errors, axis=0), spread, rtol=0.35)
    assert estimates.correlation[0, 1] < -0.9


def test_whether_the_input_shows_at_all_is_told_before_a_search():
    data = made(TRUE, seed=1)
    assert input_shows([data]) > 100
    generator = np.random.default_rng(2)
    strange = ArxData("strange", data.period_s, generator.permutation(data.inputs), data.outputs)
    assert input_shows([strange]) < 2.5


def test_on_the_faithful_craft_decimated_rates_leave_residuals_that_do_not_follow_the_input(
    flights,
):
    """Averaging over 8 rows takes most of the vibration away, which no small model could hold."""
    for axis in ("roll", "pitch"):
        fit, held = (
            axis_data(runs, axis, channel="gyro", decimate=8) for runs in flights["faithful"]
        )
        chosen = search_arx(fit, held, criterion=Criterion.PREDICTION).chosen
        left = residuals(chosen.axis, held[0])
        rows = sum(len(one.outputs) for one in fit)
        inputs = held[0].inputs[-len(left) :]
        assert cross_correlation_test(left, inputs, fitted_rows=rows).passes
        assert chosen.plausible
        assert chosen.axis.nk <= 1


def test_decimation_of_rates_averages_both_sides_alike(flights):
    (run,) = flights["faithful"][1]
    full = arx_data(run, "roll", THESIS_MOTOR, channel="gyro")
    slow = arx_data(run, "roll", THESIS_MOTOR, channel="gyro", decimate=4)
    for name in ("inputs", "outputs"):
        values = getattr(full, name)
        np.testing.assert_allclose(getattr(slow, name)[0], values[1:5].mean())
    assert np.std(slow.outputs) < np.std(full.outputs)


def test_decimation_keeps_the_fresh_angles_and_averages_the_torque(flights):
    (run,) = flights["faithful"][1]
    full = arx_data(run, "roll", THESIS_MOTOR)
    half = arx_data(run, "roll", THESIS_MOTOR, decimate=2)
    assert half.period_s == pytest.approx(0.004)
    assert np.mean(np.diff(half.outputs) != 0) > 1.5 * np.mean(np.diff(full.outputs) != 0)
    # The first of the rows that hold an angle is the one in which it is fresh.
    first = min(
        k for k in range(5) if np.array_equal(full.outputs[k::2][: len(half.outputs)], half.outputs)
    )
    rows = first + 2 * np.arange(len(half.inputs))
    np.testing.assert_allclose(half.inputs, (full.inputs[rows - 1] + full.inputs[rows]) / 2)


def test_python_control_simulates_the_same_model():
    import control

    over_z = [0.0] * TRUE.nk + list(TRUE.b)
    system = control.tf(over_z, [1.0, *TRUE.a, 0.0], TRUE.ts)
    inputs = np.random.default_rng(0).normal(size=200)
    response = control.forced_response(system, np.arange(200) * 0.002, inputs)
    np.testing.assert_allclose(response.outputs, simulate_arx(TRUE, inputs), atol=1e-15)
    assert system.dt == 0.002


@pytest.mark.parametrize(
    ("axis", "plausible"),
    [
        (THESIS.arx["roll"], True),
        (THESIS.arx["yaw"], True),
        (ArxAxis(2, 1, 0, (-1.9, 0.901), (-1e-8,), 0.002), False),
        (ArxAxis(2, 1, 0, (-1.9, 0.95), (1e-8,), 0.002), False),
    ],
    ids=["roll", "yaw", "wrong sign", "swings back"],
)
def test_a_step_of_torque_must_turn_the_axis_its_way(axis, plausible):
    assert plausible_step(axis) is plausible


def broken(**changes):
    good = made(TRUE, rows=1000)
    values = {"inputs": good.inputs, "outputs": good.outputs, "period_s": good.period_s}
    return ArxData("broken", **{**values, **changes})


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (made(TRUE, rows=200), "too few"),
        (broken(inputs=np.full(1000, 3.0)), "constant"),
        (broken(outputs=np.full(1000, np.nan)), "holes"),
        (broken(period_s=0.004), "one rate"),
    ],
    ids=["short", "constant input", "nan", "another rate"],
)
def test_data_that_cannot_tell_is_refused(data, text):
    good = made(TRUE, rows=1000)
    with pytest.raises(BadInputError, match=text):
        search_arx([good, data], [good])


def test_on_several_flights_the_chosen_models_residuals_do_not_follow_the_input():
    """Two flights on which a slow input misleads; ten of each plant: ``groundstation thesis``."""
    for seed in (102, 103):
        samples, _ = recorded(66.0, plant="faithful", seed=seed)
        given = runs_of(samples), [], MODEL, BUILT_IN["crazyflie1"]
        found = identify_arx(*given, Criterion.PREDICTION, "gyro", 4)
        assert all(test.cross.passes for test in found.evidence.residuals)
        assert not found.account["warnings"]
