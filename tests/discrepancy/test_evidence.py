"""What speaks for an effect."""

from dataclasses import replace

import numpy as np
import pytest
from affected_flights import BASE, MEDIUM, flown

from groundstation.discrepancy.acceptance import LEAST_HELD_OUT
from groundstation.discrepancy.evidence import (
    HELD_OUT_SHARE,
    beside_own_constants,
    beyond_unseen,
    by_own_noise,
    gather,
    power_beyond,
    separated,
    where_speeds_tell,
)
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.linearisation import Linear
from groundstation.identification.likelihood.parameters import VARIANTS, point_of
from groundstation.identification.likelihood.problem import Problem
from groundstation.identification.likelihood.spectra import Noise, Spectrum
from groundstation.identification.speed_noise import tells_up_to_hz

DAMPING = next(one for one in VARIANTS if one.effect == "rate_damping")
DELAY = next(one for one in VARIANTS if one.effect == "dead_time")
SPIN_UP = next(one for one in VARIANTS if one.effect == "rotor_acceleration_torque")


@pytest.fixture(scope="module")
def problem():
    flights = prepare([flown(20.0, seed, "rate_damping")[0] for seed in (1, 2)])
    found = Problem(flights, BASE, point_of(BASE))
    found.learn_noise(found.linear(found.start, found.every_key, found.flights))
    return found


def test_what_was_known_before_promises_nothing_of_held_out_rows(problem):
    """Motors that were bent against what is known of them fit held-out rows as they fit these."""
    bent = problem.start | {"a0": 1.05 * problem.start["a0"]}
    before = problem.fit(bent, ("c0", "c1", "c2"))
    after = problem.fit(problem.start, ("c0", "c1", "c2", *DAMPING.keys))
    found = gather(problem, problem.flights, before, after, DAMPING)
    # Of the very rows it was fitted to.
    assert found.expected == pytest.approx(found.held_out, rel=0.2)
    assert found.drop > found.expected + 5.0
    problem.prior = [(keys, centre, 100.0 * weight) for keys, centre, weight in problem.prior]
    costs = [problem.fit(one.point, (), steps=0).cost for one in (before, after)]
    surely = [replace(one, cost=cost) for one, cost in zip((before, after), costs, strict=True)]
    again = gather(problem, problem.flights, *surely, DAMPING)
    assert again.drop > found.drop + 500.0
    assert again.expected == pytest.approx(found.expected)


@pytest.fixture(scope="module")
def spectrum():
    hz = np.tile(np.linspace(0.1, 50.0, 500), 2)
    generator = np.random.default_rng(3)
    return Spectrum(
        0, 0, hz, np.full(1000, 2.0), np.zeros(1000), generator.normal(size=(1, 1000)), np.zeros(1)
    )


def test_an_effect_foretells_rows_of_a_flight_whose_own_constants_are_others(spectrum):
    """What is left of them is mostly a constant that is off, and the effect's column goes with the
    constant's: alone it explains nothing, beside the flight's own constant all that it promises."""
    generator = np.random.default_rng(4)
    noise, torque, other = (generator.normal(size=1000) for _ in range(3))
    effect = 0.6 * torque + 0.8 * other
    left = noise - 0.9 * torque
    after, before = (
        replace(spectrum, residual=rows, columns=torque[None], place=np.zeros(1, np.int64))
        for rows in (left, left + effect)
    )
    noises = {0: Noise(np.array([1.0]), np.array([1.0]))}
    weight = spectrum.weight
    alone = float(weight @ before.residual**2 - weight @ after.residual**2)
    assert alone < HELD_OUT_SHARE * float(weight @ effect**2)
    away, near = (Linear({}, ("c2",), [one], []) for one in (before, after))
    held, expected = beside_own_constants(away, near, noises)
    assert expected == pytest.approx(0.64 * float(weight.sum()), rel=0.1)
    assert held == pytest.approx(expected, rel=0.1)
    no_effect = Linear({}, ("c2",), [replace(after, residual=left - effect)], [])
    assert beside_own_constants(near, no_effect, noises)[0] < 0.0


def test_a_flight_is_asked_beside_noise_of_its_own_too(spectrum):
    """Fast, where it is quiet, the effect is right; slowly, where air moves it, the effect adds to
    the disturbance a little, and by the noise of any other flight that would be all that counts."""
    generator = np.random.default_rng(5)
    slow = spectrum.hz < 4.0
    noise = generator.normal(size=1000) * np.where(slow, 100.0, 1.0)
    effect = generator.normal(size=1000)
    before, after = (
        replace(spectrum, residual=rows, columns=np.empty((0, 1000)), place=np.empty(0, np.int64))
        for rows in (noise + np.where(slow, 0.0, effect), noise + np.where(slow, 0.1 * noise, 0.0))
    )
    by_other = spectrum.weight @ (before.residual**2 - after.residual**2)
    assert by_other < -10000.0
    away, near = (Linear({}, (), [one], []) for one in (before, after))
    held, expected = by_own_noise(away, near)
    assert held > 0.7 * expected > 300.0
    # of two flights each has its own limit
    two = replace(near, spectra=[after, replace(after, flight=1)])
    twice = replace(away, spectra=[before, replace(before, flight=1)])
    slowly, _ = by_own_noise(away, near.within(0.0, [4.0]))
    assert slowly < 0.0
    assert by_own_noise(twice, two.within(0.0, [4.0, np.inf]))[0] == pytest.approx(held + slowly)


@pytest.fixture(scope="module")
def turned():
    """(a problem on a craft whose rotors have an inertia, points without and with it)"""
    run, _ = flown(20.0, 3, "rotor_acceleration_torque")
    found = Problem(prepare([run]), BASE, point_of(BASE))
    found.learn_noise(found.linear(found.start, found.every_key, found.flights))
    before = found.fit(found.start, found.base_keys)
    after = found.fit(found.start | {SPIN_UP.keys[0]: 4e-8}, (*found.base_keys, *SPIN_UP.keys))
    return found, before, after


def test_moving_air_in_a_flight_does_not_hide_what_still_air_showed(turned):
    problem, before, after = turned
    air = {f"moment_{axis}": 0.1 for axis in "xy"} | {f"force_{axis}": 0.01 for axis in "xyz"}
    effects = {
        "rotor_acceleration_torque": MEDIUM["rotor_acceleration_torque"],
        "wind": air | {"moment_z": 10.0, "time_s": 0.3},
    }
    (flight,) = prepare([flown(20.0, 4, effects=effects)[0]])
    away, near = (problem.linear(one.point, (), [flight]) for one in (before, after))
    assert problem.cost_of(away)[0] - problem.cost_of(near)[0] < -1e5
    found = gather(problem, [flight], before, after, SPIN_UP)
    assert found.held_out > HELD_OUT_SHARE * found.expected > LEAST_HELD_OUT


def test_recorded_speeds_are_asked_where_they_tell(turned):
    problem, _, after = turned
    run, truth = flown(20.0, 4, "rotor_acceleration_torque")
    true = truth["rotor_rev_s"].astype(np.float64)
    noisy = true + np.random.default_rng(6).normal(0.0, 0.3, true.shape)
    flights = prepare([replace(run, rotor_rev_s=noisy), run])
    linear = problem.linear(after.point, (), flights)
    limit = tells_up_to_hz(flights[0])
    assert 5.0 < limit < 50.0
    for kept, s in zip(where_speeds_tell(linear, flights).spectra, linear.spectra, strict=True):
        inside = s.hz <= limit if s.flight == 0 else np.isfinite(s.hz)
        assert np.array_equal(kept.weight, np.where(inside, s.weight, 0.0))


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


def joint(problem, fit):
    return problem.linear(fit.point, fit.keys, problem.flights)


def test_rows_that_show_one_setting_of_five_leave_a_delay_open_and_tell_a_damping(problem):
    keys = ("c0", "c1", "c2", "thrust_per_mass", *DAMPING.keys)
    after = problem.fit(problem.start, keys)
    shown = separated(problem, joint(problem, after), DAMPING)
    assert beyond_unseen(problem, shown) == np.inf  # they are all there
    slow = Problem(
        prepare([every_fifth(flown(20.0, seed, "rate_damping")[0]) for seed in (1, 2)]),
        BASE,
        point_of(BASE),
    )
    slow.learn_noise(slow.linear(slow.start, slow.every_key, slow.flights))
    before, after = slow.fit(slow.start, keys[:4]), slow.fit(slow.start, keys)
    found = gather(slow, (), before, after, DAMPING)
    assert found.drop > 100.0
    assert found.beyond > 0.5 * found.drop
    late = {**slow.start, **dict.fromkeys(DELAY.keys, 0.004)}
    delayed = slow.fit(late, (*keys[:4], *DELAY.keys), steps=0)
    assert beyond_unseen(slow, separated(slow, joint(slow, delayed), DELAY)) < 20.0
