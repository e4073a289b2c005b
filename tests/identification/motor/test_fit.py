"""The motor fit on the stand-in's bench, and what of a recording a motor is fitted to."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from groundstation.dynamics.simulation import simulate_motor
from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR, MotorConstants
from groundstation.errors import BadInputError
from groundstation.identification.motor.fit import (
    MotorRun,
    bench_run,
    delay_in_words,
    fit_motor,
    simulate_run,
    speed_from_gate,
    validate_motor,
)
from groundstation.identification.motor.workflow import fit_motor_and_supply, motor_runs
from groundstation.identification.runs import runs_of
from support.flights import recorded, truth_of

TRUE = np.array([THESIS_MOTOR.a0, THESIS_MOTOR.a1, THESIS_MOTOR.a2])
BOTH = {"motor_dead_voltage": {"voltage_mv": 100.0}, "motor_braking_asymmetry": {"factor": 0.8}}
START_S = 5.0
"""The bench starts to turn the motor after 4 s; the gate's first readings come after."""


def bench(seconds, **settings):
    """A run of ``seconds`` on the motor bench and the true speeds of M1."""
    samples, truth = recorded(START_S + seconds + 0.5, program="motor_bench", **settings)
    (run,) = runs_of(samples)
    first = round(START_S / run.period_s)
    part = slice(first, first + round(seconds / run.period_s))
    return run[part], truth_of(samples, truth)[part]


@pytest.fixture(scope="module")
def stiff():
    return bench(50.0, plant="reduced", supply_v=3.7, seed=100)


@pytest.fixture(scope="module")
def battery():
    return bench(50.0, plant="faithful", seed=101)


def made_run(motor, seconds=8.0, noise=0.2, seed=0, delay_rows=0):
    """A bench of scipy's adaptive integrator: nothing in common with the fit."""
    generator = np.random.default_rng(seed)
    rows = round(seconds / 0.002)
    levels = generator.uniform(800, 3600, rows // 100 + 1)
    voltage = np.repeat(levels, 100)[:rows]
    speed = [120.0]
    for start in range(0, rows, 100):

        def slope(_, n, u=voltage[start]):
            return motor.a0 * u - motor.a1 * n - motor.a2 * n**2

        exact = {"t_eval": np.linspace(0, 0.2, 101)[1:], "rtol": 1e-10, "atol": 1e-9}
        speed.extend(solve_ivp(slope, (0, 0.2), [speed[-1]], **exact).y[0])
    true = np.array(speed)[:rows]
    measured = np.roll(true, delay_rows) + generator.normal(0, noise, rows)
    measured[:delay_rows] = np.nan
    # Row k's voltage acted from row k - 1 on.
    held = np.concatenate([voltage[:1], voltage[:-1]])
    return MotorRun("made", 0.002, held, measured, np.zeros(rows), np.zeros(rows))


def test_the_gate_glitches_in_at_least_one_row_of_twenty_and_the_filter_finds_them(stiff):
    run, truth = stiff
    reading, speed = speed_from_gate(run), truth["rotor_rev_s"][:, 0]
    rows = np.flatnonzero(np.isfinite(reading.rev_s))
    place = rows - reading.age_s[rows] / run.period_s
    true = np.interp(place, np.arange(len(run)), speed)
    assert np.mean(np.abs(2.0 * run.debug_s * speed - 1) > 0.05) >= 0.05
    assert reading.glitches >= 0.05
    assert np.mean(np.abs(reading.rev_s[rows] / true - 1) > 0.1) < 1e-3
    # and each speed is the true one at its age, not at its row
    aged, naive = reading.rev_s[rows] - true, reading.rev_s[rows] - speed[rows]
    assert np.median(np.abs(aged)) < 0.5 * np.median(np.abs(naive))


def test_on_a_stiff_supply_every_parameter_is_within_2_percent_and_honest(stiff):
    """Acceptance: 50 benches of 4000 samples; the truth inside 95 % in 90 % of them."""
    inside, errors = [], []
    for seed in range(50):
        run, _ = bench(8.0, plant="reduced", supply_v=3.7, seed=seed)
        fit = fit_motor([bench_run(run)])
        values, interval = fit.estimates.values[:3], fit.estimates.interval()[:3]
        errors.append(values / TRUE - 1)
        inside.append((interval[:, 0] <= TRUE) & (interval[:, 1] >= TRUE))
    assert np.abs(errors).max() < 0.02
    assert np.mean(inside, axis=0).min() >= 0.9


def test_the_fit_is_as_good_as_the_true_parameters(stiff):
    run, _ = stiff
    motor_run = bench_run(run)
    fit = fit_motor([motor_run])
    reached, _ = validate_motor(motor_run, fit.motor)
    possible, _ = validate_motor(motor_run, THESIS_MOTOR)
    assert reached > possible - 1.0
    assert fit.fit_percent[0] > 99
    assert not fit.warnings


def test_held_out_data_is_modelled_as_well(stiff):
    run, _ = stiff
    third = len(run) // 3
    fit = fit_motor([bench_run(run[: 2 * third])])
    percent, error = validate_motor(bench_run(run[2 * third :]), fit.motor)
    assert percent > 99
    assert error < 0.5


def test_several_recordings_fit_together_more_certainly_than_each_alone():
    runs = [bench_run(bench(8.0, plant="reduced", supply_v=3.7, seed=s)[0]) for s in (61, 62, 63)]
    alone = [fit_motor([run]).estimates.stderr[:3] for run in runs]
    together = fit_motor(runs)
    assert np.all(together.estimates.stderr[:3] < np.mean(alone, axis=0))
    assert len(together.fit_percent) == 3
    np.testing.assert_allclose(together.estimates.values[:3], TRUE, rtol=0.005)


def test_a_sagging_lagging_battery_biases_the_plain_fit_and_the_supply_model_removes_it(battery):
    run, truth = battery
    plain = fit_motor([bench_run(run)])
    modelled, (supply,) = fit_motor_and_supply([run], BUILT_IN["crazyflie1"])
    assert np.abs(plain.estimates.values[:2] / TRUE[:2] - 1).min() > 0.08
    assert np.abs(modelled.estimates.values[:3] / TRUE - 1).max() < 0.02
    assert modelled.fit_percent[0] > plain.fit_percent[0] + 1
    error = supply.motors_v - truth["supply_mv"] / 1000
    assert np.sqrt(np.mean(error**2)) < 0.02
    # read every fifth row: taken as new in every row 0.147 s, and four times the error
    assert supply.lag_s == pytest.approx(0.155, rel=0.015)
    assert supply.cell_ohm == pytest.approx(0.2, rel=0.02)
    assert supply.rms_v < 5e-4


@pytest.mark.parametrize(
    ("hidden", "wrong"),
    [
        ({"motor_dead_voltage": {"voltage_mv": 200.0}}, 0.2),
        ({"motor_braking_asymmetry": {"factor": 0.6}}, 0.2),
        (BOTH, 0.1),
    ],
    ids=["dead voltage", "braking", "both"],
)
def test_dead_voltage_and_slow_braking_are_found_along_with_the_motor(hidden, wrong):
    run, _ = bench(16.0, plant="reduced", supply_v=3.7, seed=103, effects=hidden)
    plain, fit = fit_motor([bench_run(run)]), fit_motor([bench_run(run)], tuple(hidden))
    assert np.abs(plain.estimates.values[:3] / TRUE - 1).max() > wrong
    np.testing.assert_allclose(fit.estimates.values[:3], TRUE, rtol=0.01)
    found = fit.estimates
    for effect, parameters in hidden.items():
        for parameter, value in parameters.items():
            name = f"{effect}.{parameter}"
            assert abs(found[name] - value) < 4 * found.error_of(name)
    held = validate_motor(bench_run(run), fit.motor, found["delay_s"], found.of_effects)
    assert held[1] < 0.5 * plain.rms_rev_s[0]


def test_effects_of_the_motor_that_are_not_there_come_out_as_absent(stiff):
    run, _ = stiff
    effects = ("motor_dead_voltage", "motor_braking_asymmetry")
    fit = fit_motor([bench_run(run[:8000])], effects)
    found, error = fit.estimates.values[4:], fit.estimates.stderr[4:]
    assert abs(found[0]) < 4 * error[0]
    assert abs(found[1] - 1) < 4 * error[1]


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"motor_dead_voltage": 150.0, "motor_braking_asymmetry": 0.8},
        {"motor_dead_voltage": 150.0, "motor_coasting": 0.7, "motor_braking_asymmetry": 0.8},
    ],
    ids=["no effect", "two", "three"],
)
def test_the_slopes_of_the_problem_are_those_of_its_simulation(effects):
    from groundstation.identification.motor.fit import MotorProblem

    run = made_run(MotorConstants(0.9, 7.0, 0.006), seconds=2.0)
    problem = MotorProblem([run], tuple(effects))
    theta = problem.theta([0.86, 6.8, 0.0061])
    theta[4 : problem.starts] = list(effects.values())
    slopes = problem.simulate(theta, 0)[1].copy()
    for column, place in enumerate(problem.places(0)[:-1]):
        step = np.zeros(len(theta))
        step[place] = 1e-5 * abs(theta[place])
        ahead = problem.simulate(theta + step, 0)[0].copy()
        change = (ahead - problem.simulate(theta - step, 0)[0]) / (2 * step[place])
        np.testing.assert_allclose(
            slopes[:, column], change, rtol=2e-3, atol=2e-3 * np.abs(change).max()
        )


@pytest.mark.parametrize("motor", [MotorConstants(0.4, 14.0, 0.03), MotorConstants(2.0, 9.0, 0.0)])
def test_other_motors_are_found_without_a_guess(motor):
    fit = fit_motor([made_run(motor)])
    assert fit.motor.a0 == pytest.approx(motor.a0, rel=0.01)
    assert fit.motor.a1 == pytest.approx(motor.a1, rel=0.01)
    assert fit.motor.a2 == pytest.approx(motor.a2, rel=0.02, abs=1e-4)


def test_readings_that_lag_by_two_rows_do_not_bias_the_motor():
    fit = fit_motor([made_run(THESIS_MOTOR, delay_rows=2)])
    assert fit.estimates["delay_s"] == pytest.approx(0.004, abs=2e-4)
    np.testing.assert_allclose(fit.estimates.values[:3], TRUE, rtol=0.01)


def test_a_fit_and_the_simulator_agree_on_what_the_motor_does():
    run = made_run(THESIS_MOTOR, noise=0.0)
    speed, _ = simulate_motor(THESIS_MOTOR, run.voltage_mv[1:, None], 0.002, [120.0])
    np.testing.assert_allclose(simulate_run(run, THESIS_MOTOR), speed[:, 0], atol=1e-3)


def hover(name, steps, noise):
    """Around one speed, 100 rows a step."""
    generator = np.random.default_rng(7)
    voltage = 2200 + np.repeat(generator.uniform(-50, 50, steps), 100)
    speed, _ = simulate_motor(THESIS_MOTOR, voltage[1:, None], 0.002)
    measured, nothing = speed[:, 0] + generator.normal(0, noise, 100 * steps), np.zeros(100 * steps)
    return MotorRun(name, 0.002, voltage, measured, nothing, nothing)


def test_around_one_speed_only_the_uncertainty_is_large_and_said():
    fit = fit_motor([hover("hover", 40, 3.0)])
    assert any("a2 is hardly excited: uncertain by" in text for text in fit.warnings)
    assert abs(fit.estimates.values[2] / TRUE[2] - 1) < 1.0


def test_constants_known_to_their_own_size_are_no_motor():
    with pytest.raises(BadInputError, match=r"short: a[01] is not identified"):
        fit_motor([hover("short", 6, 60.0)])


def test_what_can_tell_no_motor_is_refused():
    run = made_run(THESIS_MOTOR)
    against = replace(run, voltage_mv=run.voltage_mv.max() + 800.0 - run.voltage_mv)
    holed = replace(run, voltage_mv=np.where(np.arange(len(run.rev_s)) == 100, np.nan, 2000.0))
    for one, why in (
        (replace(run, voltage_mv=np.full_like(run.rev_s, 2000.0)), "constant"),
        (made_run(THESIS_MOTOR, seconds=0.3), "too few"),
        (holed, "voltage is missing"),
        (against, r"a[01] is not identified, because"),  # a sensor on another motor, say
    ):
        with pytest.raises(BadInputError, match=why):
            fit_motor([one])


def test_a_load_that_seems_to_shrink_with_speed_is_a_motor_of_first_order():
    run = made_run(MotorConstants(2.0, 9.0, 0.0))
    bent = replace(run, rev_s=run.rev_s * (1 + 4e-5 * run.rev_s))
    fit = fit_motor([bent])
    assert fit.motor.a2 == 0.0
    assert fit.motor.a1 > 0
    assert any("a motor of first order" in text for text in fit.warnings)


@pytest.mark.parametrize(
    ("rows", "said"),
    [(0, "no delay of the readings can be told (less than"), (2, "ms late"), (-2, "ms ahead of")],
)
def test_a_delay_that_cannot_be_is_said_in_words(rows, said):
    run = made_run(THESIS_MOTOR)
    moved = replace(run, rev_s=np.roll(run.rev_s, rows))
    assert said in delay_in_words(fit_motor([moved]).estimates)


@pytest.fixture(scope="module")
def samples():
    return recorded(10.0, seed=6, plant="reduced")[0]


@pytest.fixture(scope="module")
def measured(samples):
    """The same of a craft whose rotor speeds are recorded."""
    return replace(samples, rotor_rev_s=np.full_like(samples.rotor_rev_s, 200.0))


def without(samples, lost):
    kept = np.ones(len(samples), np.bool_)
    kept[lost] = False
    return samples[kept]


def lengths(samples):
    return [len(run) for run in motor_runs([(samples, "flight")])]


def test_flights_are_cut_where_rows_are_lost_when_long_stretches_hold_most(measured):
    assert lengths(without(measured, 2500)) == [2500, len(measured) - 2501]


def test_flights_that_losses_cut_to_pieces_are_bridged(measured):
    assert lengths(without(measured, slice(500, None, 500))) == [len(measured)]


def test_a_motor_bench_is_never_bridged(samples):
    lost = slice(600, None, 600)
    assert max(lengths(without(samples, lost))) == 600
