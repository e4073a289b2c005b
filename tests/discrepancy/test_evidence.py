"""What speaks for an effect."""

from dataclasses import replace

import numpy as np
import pytest
from affected_flights import BASE, flown

from groundstation.discrepancy.evidence import (
    HELD_OUT_SHARE,
    beside_own_constants,
    beyond_unseen,
    by_own_spectra,
    gather,
    power_beyond,
    separated,
)
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.linearisation import Linear
from groundstation.identification.likelihood.parameters import VARIANTS, point_of
from groundstation.identification.likelihood.problem import Problem
from groundstation.identification.likelihood.spectra import Noise, Spectrum

DAMPING = next(one for one in VARIANTS if one.effect == "rate_damping")
DELAY = next(one for one in VARIANTS if one.effect == "dead_time")


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
    assert found.held_out.expected == pytest.approx(found.held_out.drop, rel=0.2)
    assert found.drop > found.held_out.expected + 5.0
    problem.prior = [(keys, centre, 100.0 * weight) for keys, centre, weight in problem.prior]
    costs = [problem.fit(one.point, (), steps=0).cost for one in (before, after)]
    surely = [replace(one, cost=cost) for one, cost in zip((before, after), costs, strict=True)]
    again = gather(problem, problem.flights, *surely, DAMPING)
    assert again.drop > found.drop + 500.0
    assert again.held_out == found.held_out


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
    away, near = (Linear({}, ("c2",), [one], []) for one in (before, after))
    alone = by_own_spectra(away, near)
    assert alone.drop < HELD_OUT_SHARE * alone.expected
    told = beside_own_constants(away, near)
    # 0.8 of the effect goes with nothing else, beside noise of twice 1 in each bin.
    assert told.information == pytest.approx(0.64 * 0.5 * float(spectrum.weight.sum()), rel=0.1)
    assert told.expected < told.information
    assert told.drop == pytest.approx(told.expected, rel=0.1)
    no_effect = Linear({}, ("c2",), [replace(after, residual=left - effect)], [])
    assert beside_own_constants(near, no_effect).drop < 0.0


def test_a_flight_is_judged_by_its_own_noise(spectrum):
    """Fast, where it is quiet, the effect is right; slowly, where air moves it, the effect adds to
    the disturbance a little, and by the noise of any other flight that would be all that counts."""
    generator = np.random.default_rng(5)
    slow = spectrum.hz < 4.0
    noise = generator.normal(size=1000) * np.where(slow, 100.0, 1.0)
    column = generator.normal(size=1000)
    before = replace(spectrum, residual=noise + np.where(slow, 0.0, column))
    after = replace(spectrum, residual=noise + np.where(slow, 0.1 * noise, 0.0))
    by_other = spectrum.weight @ (before.residual**2 - after.residual**2)
    assert by_other < -10000.0
    away, near = (Linear({}, (), [one], []) for one in (before, after))
    told = by_own_spectra(away, near)
    assert told.drop > 0.7 * told.expected > 300.0
    # A limit on what counts takes the part away that is above it.
    assert by_own_spectra(away.below([4.0]), near.below([4.0])).drop < 0.0


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
