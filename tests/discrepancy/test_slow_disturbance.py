"""What acts slowly and belongs to no flight condition is called wind, and nothing else is."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2, norm
from searched_flights import base_model, flights

from groundstation.comparison.comparison import compare
from groundstation.discrepancy.acceptance import Stage, lasting_refusal
from groundstation.discrepancy.engine import find_effects
from groundstation.discrepancy.findings import Verdict
from groundstation.discrepancy.proof import HeldOut, Predictions
from groundstation.discrepancy.slow_disturbance import (
    LIFT_SHARE,
    PACES_S,
    options,
    slow_part,
    standard_errors,
    with_wind,
)
from groundstation.telemetry.packet import STANDARD_GRAVITY

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
    assert lasting_refusal(Stage.WEIGHED, slow.asked()) is None


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


def test_flights_too_short_to_tell_it_alone_tell_it_together():
    """Seven seconds each, and a moment that only the second has."""
    generator = np.random.default_rng(4)
    still, again, moved = (generator.normal(0.0, 1.0, (3500, 6)) for _ in range(3))
    moved[:, 1] += 4.0

    def predictions(missing):
        return SimpleNamespace(of=lambda model: SimpleNamespace(errors=[errors(missing)]))

    for one in (still, moved):
        assert slow_part([errors(one)]).t == 0.0
    _, (told, settled) = options(base_model(), predictions(still), predictions(moved))
    assert told.t > 5.0
    assert settled().spread[1] > 0.0
    _, (told, _) = options(base_model(), predictions(still), predictions(again))
    assert told.t < 3.0


@pytest.fixture(scope="module")
def searched():
    """Stand-in flights in wind and in still air: the findings, with and without that name."""

    def look(seed, effects):
        runs, held = flights(seed, effects)
        train = Predictions(compare(runs, base_model()))
        judged = HeldOut(compare(held, base_model(), train.before.black_box))
        before = find_effects(runs, base_model(), held, judged=judged)
        return before, with_wind(before, train, judged), judged

    return {"wind": look(8, {"wind": BLOWN}), "still": look(9, {})}


def test_wind_is_named_with_its_spread_and_held_out_rows_are_predicted_better(searched):
    before, after, judged = searched["wind"]
    assert before.effects == ()
    (found,) = after.effects
    assert found.name == "wind"
    assert after.verdict == Verdict.EFFECTS_FOUND
    given, improved = judged.judge(before.model), judged.judge(after.model)
    assert not improved.worse
    assert improved.gap**2 - 1.0 < 0.5 * (given.gap**2 - 1.0)
    force = found.parameters["force_x"]
    assert force.value == pytest.approx(BLOWN["force_x"], rel=0.6)
    (candidate,) = [one for one in after.candidates if one.name == "wind"]
    assert candidate.accepted
    assert found.parameters["time_s"].value in (1.0, 3.0)


def test_in_still_air_there_is_none(searched):
    before, after, _ = searched["still"]
    assert after is before


def test_spreads_are_held_to_be_no_smaller_than_those_of_flights_in_general():
    generator = np.random.default_rng(3)
    missing = generator.normal(0.0, 1.0, (100_000, 6))
    missing[:, 1] += drifting(200.0, 3.0, 8.0, generator)
    slow = slow_part([errors(missing)]).at(3.0)
    least = slow.with_trims(np.array([5.0, 4.0, 0.5, 0.0, 0.0, 0.3]))
    assert least.spread.tolist() == [5.0, slow.spread[1], 0.5, 0.0, 0.0, 0.3]
    told = {name: one.stderr is not None for name, one in least.parameters.items()}
    assert [name for name, known in told.items() if known] == ["moment_y", "time_s"]


@pytest.fixture(scope="module")
def battery_moved():
    """Two flights, and one to validate on in which the battery lies 1.5 mm elsewhere: what is
    found, and the predictions of held-out rows."""
    runs, _ = flights(9)
    _, held = flights(9, {"centre_of_gravity_offset": {"x_m": 0.0015, "y_m": 0.0}})
    train = Predictions(compare(runs, base_model()))
    judged = HeldOut(compare(held, base_model(), train.before.black_box))
    return find_effects(runs, base_model(), held, judged=judged), train, judged


def test_a_battery_that_only_the_held_out_flight_has_elsewhere_is_followed(battery_moved):
    before, train, judged = battery_moved
    after = with_wind(before, train, judged)
    (found,) = after.effects
    assert found.name == "wind"
    assert found.parameters["moment_y"].stderr is None, "no fitted flight tells it"
    lift = found.parameters["force_z"]
    assert lift.value == pytest.approx(LIFT_SHARE * STANDARD_GRAVITY)
    assert lift.stderr is None
    assert found.parameters["time_s"].value == PACES_S[-1]
    given, improved = judged.judge(before.model), judged.judge(after.model)
    assert not improved.worse
    assert improved.gap**2 - 1.0 < 0.2 * (given.gap**2 - 1.0)


def test_a_model_that_has_it_already_keeps_it(searched):
    _, after, judged = searched["wind"]
    assert with_wind(after, judged, judged) is after
