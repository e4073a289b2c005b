"""The rolling predictor: the same whatever the pieces, and the gap of a model that is right."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.model import EffectTerm, Estimate
from groundstation.errors import BadInputError
from groundstation.identification.runs import runs_of
from groundstation.prediction.prediction import fly_ahead, observe_run
from groundstation.telemetry.samples import SampleBatch
from groundstation.twin.signals import KINDS
from groundstation.twin.twin import Rolling
from support.flights import BASE
from support.flights import twin_flight as flight

SAMPLES = flight(24.0, 1)


def blocks_of(model, pieces):
    """All blocks of some pieces of a stream: fast time."""
    rolling = Rolling(model)
    return [block for piece in pieces for block in rolling.feed(piece)]


def pieces(samples, rows):
    return [samples[first : first + rows] for first in range(0, len(samples), rows)]


def test_what_comes_out_does_not_depend_on_how_the_samples_were_cut():
    whole = blocks_of(BASE, [SAMPLES])
    assert len(whole) == 46
    for rows in (7, 250, 1111):
        parts = blocks_of(BASE, pieces(SAMPLES, rows))
        assert len(parts) == len(whole)
        for one, other in zip(parts, whole, strict=True):
            np.testing.assert_array_equal(one.total, other.total)
            np.testing.assert_array_equal(one.predicted, other.predicted)
            assert one.last_s == other.last_s


def test_it_is_the_observer_of_the_whole_flight_in_parts():
    """Until the noise is learnt the predictions are those of one pass over the whole flight."""
    (run,) = runs_of(SAMPLES)
    seen = observe_run(BASE, run)
    blocks = [block for block in blocks_of(BASE, pieces(SAMPLES, 100)) if block.first_s < 6.0]
    flown = [block for block in blocks if np.isfinite(block.error).all()]
    assert len(flown) >= 3
    for block in flown:
        rows = np.searchsorted(SAMPLES.time_s, block.time_s - 1e-4)
        ahead = fly_ahead(run, seen, rows - 25, [10, 25])
        np.testing.assert_allclose(ahead.gyro[:, 1], block.predicted[:, :3], atol=1e-5)
        np.testing.assert_allclose(ahead.accelerometer[:, 1], block.predicted[:, 3:6], atol=2e-3)


def test_the_gap_of_a_model_that_is_right_is_one():
    blocks = [block for block in blocks_of(BASE, [flight(60.0, 1)]) if block.windows]
    error = np.mean([block.error for block in blocks], axis=0)
    expected = np.mean([block.leaves @ block.step for block in blocks], axis=0)
    np.testing.assert_allclose(np.sqrt(error / expected), 1.0, atol=0.25)


def test_the_predictions_are_nearer_than_what_was_measured_when_they_were_made():
    blocks = [block for block in blocks_of(BASE, [SAMPLES]) if block.windows]
    measured = np.vstack([block.measured for block in blocks])
    predicted = np.vstack([block.predicted for block in blocks])
    late = np.vstack([block.measured[:-5] - block.measured[5:] for block in blocks])
    assert (np.std(measured - predicted, axis=0)[:3] < 0.5 * late.std(axis=0)[:3]).all()


@pytest.mark.parametrize(
    ("name", "kind", "size"),
    [
        ("velocity_moment", ("torque", 0, "v"), 15.0),
        ("rotor_drag", ("force", 0, "u"), -0.012 / 0.023),
        ("rate_damping", ("torque", 1, "q"), -2e-5 / 1.0e-5),
    ],
)
def test_a_score_over_its_energy_is_the_size_of_what_was_hidden(name, kind, size):
    blocks = [block for block in blocks_of(BASE, [flight(40.0, 2, name)]) if block.windows]
    weight = 1.0 / np.median([block.square for block in blocks], axis=0)
    number = [(each.acts, each.axis, each.drive) for each in KINDS].index(kind)
    total = sum(weight @ block.total[:, number] for block in blocks)
    energy = sum(weight @ block.energy[:, number] for block in blocks)
    assert total / energy == pytest.approx(size, rel=0.25)


def test_nothing_is_judged_on_the_ground_nor_right_after_a_take_off():
    samples = flight(24.0, 1)
    blocks = blocks_of(BASE, [samples])
    turning = samples.time_s[np.flatnonzero((samples.duty > 0.1).any(axis=1))[0]]
    early = [block for block in blocks if block.first_s < turning]
    assert early
    assert all(block.windows == 0 for block in early)
    assert all(np.isnan(block.error).all() for block in early)


def test_after_a_restart_or_a_silence_it_begins_anew():
    first, later = SAMPLES[:6000], SAMPLES[6100:]
    blocks = blocks_of(BASE, [first, later])
    again = [block for block in blocks if block.first_s >= later.time_s[0] - 1e-6]
    assert again[0].begins
    assert again[0].first_s == later.time_s[0]
    assert all(block.last_s <= first.time_s[-1] + 1e-6 for block in blocks if block not in again)


def test_lost_rows_cost_their_neighbours_and_nothing_else():
    samples = flight(40.0, 3)
    kept = np.ones(len(samples), bool)
    kept[9000:9003] = False
    whole, holed = blocks_of(BASE, [samples]), blocks_of(BASE, [samples[kept]])
    assert [one.last_s for one in whole] == pytest.approx([one.last_s for one in holed], abs=2e-3)
    fewer = [a.windows - b.windows for a, b in zip(whole, holed, strict=True)]
    assert 3 <= sum(fewer) <= 8


WORDS = {"battery_v": "battery voltage", "gyro": "gyro", "attitude": "attitude"}


@pytest.mark.parametrize("channel", list(WORDS))
def test_telemetry_without_what_a_model_needs_is_refused_by_name(channel):
    lacking = replace(SAMPLES, **{channel: np.full_like(getattr(SAMPLES, channel), np.nan)})
    with pytest.raises(BadInputError, match=WORDS[channel]):
        blocks_of(BASE, [lacking])


def test_single_samples_are_as_good_as_batches():
    few = SAMPLES[:1200]
    one_by_one = blocks_of(BASE, pieces(few, 1))
    assert len(one_by_one) == len(blocks_of(BASE, [few]))
    assert blocks_of(BASE, [SampleBatch.concatenate([])]) == []


def test_a_model_with_the_effect_leaves_no_gap_where_the_base_model_does():
    samples = flight(40.0, 2, "rotor_drag")
    term = EffectTerm("rotor_drag", {"drag_n_s_m": Estimate(0.012)})
    gaps = []
    for model in (BASE, msgspec.structs.replace(BASE, effects=(term,))):
        blocks = [block for block in blocks_of(model, [samples]) if block.windows]
        gaps.append(np.mean([block.error[:, 3:5].sum() for block in blocks]))
    assert gaps[1] < 0.95 * gaps[0]
