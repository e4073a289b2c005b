"""What acts slowly and belongs to no flight condition is a disturbance, and nothing else is."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2, norm

from groundstation.comparison.comparison import compare
from groundstation.discrepancy.disturbances import slow_part, standard_errors, with_disturbance
from support.flights import base_model
from support.flights import searched as flights

PERIOD_S, AHEAD = 0.002, 25
BLOWN = {
    "moment_x": 3.0,
    "moment_y": 3.0,
    "moment_z": 1.5,
    "force_x": 0.3,
    "force_y": 0.3,
    "force_z": 0.1,
    "time_s": 2.0,
}
CASES = ((8, {"wind": BLOWN}), (9, {}))


def errors(missing):
    """Prediction errors of a flight in which these moments and forces (n, 6) are missing."""
    last = np.column_stack([missing, np.zeros((len(missing), 3))])
    last[:, :3] *= AHEAD * PERIOD_S
    rows = np.full(9, AHEAD)
    run = SimpleNamespace(period_s=PERIOD_S)
    return SimpleNamespace(run=run, horizons=(last, last), rows=(rows, rows))


def drifting(seconds, time_s, spread, generator):
    """Noise through a first-order low-pass, with this spread."""
    count, kept = round(seconds / PERIOD_S), np.exp(-PERIOD_S / time_s)
    driven = generator.normal(size=count) * np.sqrt(1.0 - kept**2)
    return spread * lfilter([1.0], [1.0, -kept], driven)


def test_the_spread_of_what_drifts_is_told_beside_noise():
    generator = np.random.default_rng(1)
    missing = generator.normal(0.0, 5.0, (200_000, 6))
    for column, spread in ((0, 3.0), (4, 0.4)):
        missing[:, column] = drifting(400.0, 3.0, spread, generator)
        missing[:, column] += generator.normal(0.0, 5.0 * spread, 200_000)
    slow = slow_part([errors(missing)]).at(3.0)
    assert np.flatnonzero(slow.spread).tolist() == [0, 4]
    assert slow.spread[[0, 4]] == pytest.approx([3.0, 0.4], rel=0.2)


def test_noise_alone_does_not_last():
    missing = np.random.default_rng(2).normal(0.0, 5.0, (100_000, 6))
    assert not slow_part([errors(missing)]).spread.any()


def test_standard_errors_are_those_of_the_surest_channel_or_of_all_together():
    alone, shared = np.array([25.0, 0, 0, 0, 0, 0]), np.full(6, 8.0)
    assert standard_errors(alone) == 5.0
    assert standard_errors(shared) == pytest.approx(norm.isf(0.5 * chi2.sf(48.0, 6)))
    assert standard_errors(np.zeros(6)) == 0.0
    assert standard_errors(np.full(6, 1e4)) == 100.0


def test_noise_seldom_seems_to_last():
    generator, chance = np.random.default_rng(3), []
    for _ in range(400):
        missing = generator.normal(0.0, 5.0, (60, 6))  # half seconds, each a row
        chance.append(slow_part([half_seconds(missing)]).t)
    assert np.mean(np.array(chance) > 3.0) < 0.03
    assert max(chance) < 4.5


def test_what_is_a_little_in_every_channel_passes_its_gate():
    generator = np.random.default_rng(5)
    time_s = 0.5 * np.arange(100)[:, None]
    swaying = 0.75 * np.sin(2.0 * np.pi * time_s / 25.0 + np.arange(6.0))
    slow = slow_part([half_seconds(swaying + generator.normal(0.0, 1.0, (100, 6)))])
    assert 1 <= np.count_nonzero(slow.spread) < 6
    assert slow.t > 4.5
    assert slow.is_there


def half_seconds(missing):
    """``errors`` of rows so slow that each is a block of its own."""
    one = errors(missing)
    one.run.period_s = 0.5
    rows = np.full(9, AHEAD * PERIOD_S / 0.5)
    return SimpleNamespace(run=one.run, horizons=one.horizons, rows=(rows, rows))


def test_a_flight_that_was_hardly_judged_tells_nothing():
    missing = np.full((100_000, 6), np.nan)
    missing[:2000] = 1.0
    assert not slow_part([errors(missing)]).spread.any()


@pytest.fixture(scope="module")
def compared():
    """(stand-in flights in wind, in still air) as the true model predicts them."""
    return [compare(flights(seed, effects)[0], base_model()) for seed, effects in CASES]


def test_wind_is_followed_with_its_spread_and_flights_that_it_was_not_learnt_from_are_too(compared):
    blown, _ = compared
    model = with_disturbance(base_model(), blown)
    assert model.effects == ()
    slow = model.disturbance
    assert slow.forces[0] == pytest.approx(BLOWN["force_x"], rel=0.6)
    assert slow.time_s in (1.0, 3.0)
    _, held = flights(8, {"wind": BLOWN})
    before = compare(held, base_model(), blown.black_box)
    after = before.with_model(model)
    assert after.beside(before) ** 2 - 1.0 < 0.5 * (before.gap**2 - 1.0)


def test_in_still_air_there_is_none(compared):
    _, still = compared
    assert with_disturbance(base_model(), still).disturbance is None


def test_spreads_are_held_to_be_no_smaller_than_those_of_flights_in_general():
    generator = np.random.default_rng(3)
    missing = generator.normal(0.0, 1.0, (100_000, 6))
    missing[:, 1] += drifting(200.0, 3.0, 8.0, generator)
    slow = slow_part([errors(missing)]).at(3.0)
    least = slow.with_trims(np.array([5.0, 4.0, 0.5, 0.0, 0.0, 0.3]))
    assert least.spread.tolist() == [5.0, slow.spread[1], 0.5, 0.0, 0.0, 0.3]
    told = {name: one.stderr is not None for name, one in least.parameters.items()}
    assert [name for name, known in told.items() if known] == ["moment_y", "time_s"]
