"""What speaks for an effect."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.discrepancy.screening import (
    Parts,
    beyond_unseen,
    cross_validated,
    folds_of,
    gather,
    median_of,
    power_beyond,
    separated,
)
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.linear import Spectrum
from groundstation.identification.likelihood.motion import VARIANTS, point_of
from groundstation.identification.likelihood.problem import (
    Noise,
    Problem,
)
from support.flights import BASE, flown

DAMPING = next(one for one in VARIANTS if one.effect == "rate_damping")
DELAY = next(one for one in VARIANTS if one.effect == "dead_time")
GROUND = next(one for one in VARIANTS if one.effect == "ground_effect")


@pytest.fixture(scope="module")
def problem():
    flights = prepare([flown(20.0, seed, "rate_damping")[0] for seed in (1, 2)])
    found = Problem(flights, BASE, point_of(BASE))
    found.learn_noise(found.linear(found.start, found.every_key, found.flights))
    return found


KEYS = ("c0", "c1", "c2", *DAMPING.keys)


@pytest.fixture(scope="module")
def after(problem):
    """The joint fit of the damping."""
    return problem.fit(problem.start, KEYS)


def shifted(linear, key, by):
    """A linearisation whose second flight has so much less of a column in its residuals."""
    (place,) = linear.place([key])
    spectra = [
        replace(s, residual=s.residual - by * s.columns[list(s.place).index(place)])
        if s.flight == 1 and place in s.place
        else s
        for s in linear.spectra
    ]
    return replace(linear, spectra=spectra)


def test_an_effects_drop_is_what_the_fit_without_it_costs_more(problem, after):
    before = problem.fit(problem.start, ("c0", "c1", "c2"))
    (found,) = gather(problem, problem.flights, after, [DAMPING])
    assert found.drop == pytest.approx(before.cost - after.cost, rel=0.1)
    assert found.held_out == pytest.approx(found.expected, rel=0.2)
    assert found.expected == pytest.approx(found.drop, rel=0.1)


def test_the_drop_of_an_effect_is_as_large_where_its_shape_is_hardly_known():
    hidden = {"ground_effect": {"gain": 0.3, "height_m": 0.1}}
    flights = prepare([flown(20.0, seed, effects=hidden)[0] for seed in (1, 2)])
    problem = Problem(flights, BASE, point_of(BASE))
    problem.learn_noise(problem.linear(problem.start, problem.every_key, problem.flights))
    before = problem.fit(problem.start, problem.base_keys)
    keys = (*problem.base_keys, *GROUND.keys)
    after = problem.fit({**before.point, "ground_effect.gain": 0.1}, keys)
    (found,) = gather(problem, problem.flights, after, [GROUND])
    (gain,) = GROUND.sizes
    assert (after.point[gain] / after.stderr()[gain]) ** 2 < 0.5 * found.drop
    assert found.drop == pytest.approx(before.cost - after.cost, rel=0.2)
    assert found.held_out == pytest.approx(found.expected, rel=0.2)


def test_what_was_known_before_promises_nothing_of_flights_left_out(problem, after, monkeypatch):
    (found,) = gather(problem, problem.flights, after, [DAMPING])
    surely = [replace(one, weight=100.0 * one.weight) for one in problem.prior]
    monkeypatch.setattr(problem, "prior", surely)
    (again,) = gather(problem, problem.flights, after, [DAMPING])
    assert again.expected == pytest.approx(found.expected)


def test_each_effect_of_a_fit_is_asked_beside_the_others(problem):
    both = problem.fit(problem.start, (*KEYS, *DELAY.keys))
    damping, delay = gather(problem, problem.flights, both, [DAMPING, DELAY])
    assert damping.t > 10.0 > abs(delay.t)
    assert damping.drop > 20.0 > delay.drop


def test_a_flight_is_asked_with_the_size_that_the_others_say(problem, after):
    linear, (size,) = problem.linear(after.point, KEYS, problem.flights), DAMPING.sizes
    there = np.array([after.point[size]])
    held, expected = cross_validated(linear, Parts.of(problem, linear), DAMPING.keys, there)
    assert held == pytest.approx(expected, rel=0.2)
    turned = shifted(linear, size, 2.0 * there[0])
    held, expected = cross_validated(turned, Parts.of(problem, turned), DAMPING.keys, there)
    assert held < 0.0 < expected


def test_a_flight_whose_own_constants_are_others_is_asked_with_these(problem, after):
    linear, there = problem.linear(after.point, KEYS, problem.flights), after.point
    size = np.array([there[DAMPING.sizes[0]]])
    held, _ = cross_validated(linear, Parts.of(problem, linear), DAMPING.keys, size)
    other = shifted(linear, "c0", -0.2 * there["c0"])
    again, _ = cross_validated(other, Parts.of(problem, other), DAMPING.keys, size)
    assert again == pytest.approx(held, rel=0.2)


def test_a_flight_that_is_alone_has_its_thirds_left_out(problem):
    first, second = problem.flights
    assert folds_of([first, second]) == [first, second]
    thirds = folds_of([first])
    assert len(thirds) == 3
    assert sum(one.last - one.first for one in thirds) <= first.last - first.first


@pytest.fixture(scope="module")
def spectrum():
    hz = np.tile(np.linspace(0.1, 50.0, 500), 2)
    generator = np.random.default_rng(3)
    return Spectrum(
        0, 0, hz, np.full(1000, 2.0), np.zeros(1000), generator.normal(size=(1, 1000)), np.zeros(1)
    )


def test_a_late_answer_to_the_motors_is_not_beyond_what_settings_between_rows_can_do(spectrum):
    answer, noise = spectrum.columns[0], Noise(np.array([1.0]), np.array([0.5]))
    late = 2.0 * np.pi * spectrum.hz * 0.004 * answer
    assert power_beyond(late, answer, spectrum, noise, 0.008) == 0.0
    whole = float((spectrum.weight / 0.5 * late**2).sum())
    assert power_beyond(late, answer, spectrum, noise, 0.002) > 0.7 * whole
    assert power_beyond(late, 0.0 * answer, spectrum, noise, 0.008) == pytest.approx(whole)


def test_what_acts_slowly_is_beyond_what_settings_between_rows_can_do(spectrum):
    noise = Noise(np.array([1.0]), np.array([0.5]))
    slowly = np.where(spectrum.hz < 1.0, 0.1, 0.0)
    whole = float((spectrum.weight / 0.5 * slowly**2).sum())
    answer = np.full(len(spectrum.hz), 1.0)
    assert power_beyond(slowly, answer, spectrum, noise, 0.008) > 0.8 * whole


def every_fifth(run):
    """What a log of a fifth of the rows has: one setting of five."""
    columns = (
        "duty", "supply_v", "gyro", "accelerometer", "attitude", "rotor_rev_s", "debug_s",
        "duty_step",
    )  # fmt: skip
    return replace(run, period_s=0.01, **{name: getattr(run, name)[::5] for name in columns})


def beyond(problem, fit, variant):
    linear = problem.linear(fit.point, fit.keys, problem.flights)
    return beyond_unseen(problem, linear, separated(linear, problem.with_prior(linear), variant))


def test_rows_that_show_one_setting_of_five_leave_a_delay_open_and_tell_a_damping(problem):
    keys = ("c0", "c1", "c2", "thrust_per_mass", *DAMPING.keys)
    after = problem.fit(problem.start, keys)
    assert beyond(problem, after, DAMPING) == np.inf  # they are all there
    slow = Problem(
        prepare([every_fifth(flown(20.0, seed, "rate_damping")[0]) for seed in (1, 2)]),
        BASE,
        point_of(BASE),
    )
    slow.learn_noise(slow.linear(slow.start, slow.every_key, slow.flights))
    (found,) = gather(slow, (), slow.fit(slow.start, keys), [DAMPING])
    assert found.drop > 100.0
    assert found.beyond > 0.5 * found.drop
    late = {**slow.start, **dict.fromkeys(DELAY.keys, 0.004)}
    delayed = slow.fit(late, (*keys[:4], *DELAY.keys), steps=0)
    assert beyond(slow, delayed, DELAY) < 20.0


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30))
def test_a_median_is_numpys(numbers):
    values = np.array(numbers)
    assert median_of(values) == np.median(values)
