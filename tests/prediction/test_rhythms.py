"""Which rows hold a new attitude, or a new reading of the battery."""

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.model import EffectTerm, Estimate
from groundstation.prediction.drive import (
    between_readings,
    changed_rows,
    drive_run,
    fresh_rhythm,
    fresh_rows,
    held,
    reading_rhythm,
    rhythm_of,
)
from support.flights import BASE, flown

ROWS = 400


def angles(stride, phase=0, seed=1):
    """Angles that are new every ``stride`` rows."""
    new = np.cumsum(np.random.default_rng(seed).normal(size=(ROWS, 3)), axis=0)
    rows = np.arange(ROWS)
    return new[np.maximum(rows - (rows - phase) % stride, 0)]


@pytest.mark.parametrize(("stride", "phase"), [(1, 0), (2, 0), (2, 1), (5, 3)])
def test_held_angles_tell_how_often_and_when_the_attitude_is_new(stride, phase):
    shown = angles(stride, phase)
    rhythm = fresh_rhythm(shown)
    assert (rhythm.stride, rhythm.phase, rhythm.regular) == (stride, phase, True)
    held = fresh_rows(shown)[phase:].reshape(-1)
    np.testing.assert_array_equal(np.flatnonzero(held) % stride, 0)
    assert (np.diff(shown, axis=0)[~fresh_rows(shown)[1:]] == 0).all()


def test_held_angles_that_are_left_out_tell_the_same():
    shown = angles(2, 1)
    left_out = np.where(fresh_rows(shown)[:, None], shown, np.nan)
    assert fresh_rhythm(left_out) == fresh_rhythm(shown)


def test_the_rhythm_survives_lost_rows():
    shown = angles(2)
    shown[np.random.default_rng(2).random(ROWS) < 0.05] = np.nan
    assert fresh_rhythm(shown) == fresh_rhythm(angles(2))
    assert not changed_rows(shown)[np.isnan(shown).any(axis=1)].any()


def test_a_craft_that_rests_half_of_the_time_has_the_rhythm_of_the_other_half():
    shown = angles(2)
    shown[: ROWS // 2] = shown[0]
    assert fresh_rhythm(shown) == fresh_rhythm(angles(2))


def test_without_a_rhythm_every_row_counts():
    irregular = np.cumsum(np.random.default_rng(3).random((ROWS, 1)) < 0.4, axis=0) * np.ones(3)
    assert fresh_rows(irregular).all()
    assert fresh_rows(np.full((ROWS, 3), np.nan)).all()
    assert not rhythm_of(changed_rows(irregular)).regular


REPORTED = 4000


def report(stride, phase=0, seed=1):
    """A sinking voltage in whole millivolts, read every ``stride`` rows."""
    wander = np.cumsum(np.random.default_rng(seed).normal(0.0, 4e-4, REPORTED))
    volts = np.round(4.0 - 2e-5 * np.arange(REPORTED) + wander, 3)
    read = np.arange(phase, REPORTED, stride)
    return held(volts[read], read, REPORTED)


@pytest.mark.parametrize(("stride", "phase"), [(2, 1), (5, 0), (5, 3), (10, 7)])
def test_the_rows_of_the_readings_are_known_by_where_the_report_changes(stride, phase):
    found = reading_rhythm(report(stride, phase))
    assert (found.stride, found.phase) == (stride, phase)


@pytest.mark.parametrize("shown", [report(1), np.full(REPORTED, 3.7), report(5)[:200]])
def test_a_report_that_shows_no_rhythm_is_taken_as_read_in_every_row(shown):
    assert reading_rhythm(shown).stride == 1
    np.testing.assert_array_equal(between_readings(shown), shown)


def test_between_two_readings_the_report_is_a_line_that_knows_of_no_later_one():
    shown = report(5, 2)
    line = between_readings(shown)
    np.testing.assert_allclose(line[6::5], shown[6::5], atol=1e-12)
    assert np.ptp(np.diff(line)[6:11]) < 1e-12
    later = shown.copy()
    later[2002:] += 0.1
    np.testing.assert_array_equal(between_readings(later)[:2002], line[:2002])


def test_rotors_turn_as_they_did_behind_a_filter_that_is_fed_every_fifth_row():
    """rev/s of 220; taken as new in every row the report left 0.030."""
    run, truth = flown(30.0, 5, plant="faithful")
    terms = (
        EffectTerm("battery_reading_lag", {"time_constant_s": Estimate(0.155)}),
        EffectTerm("supply_sag", {"resistance_ohm": Estimate(0.08)}),
    )
    model = msgspec.structs.replace(BASE, effects=terms)
    rows = np.flatnonzero((run.duty > 0.2).all(axis=1))[500:-100]
    error = (drive_run(model, run).rotor_rev_s - truth["rotor_rev_s"])[rows]
    assert np.sqrt(np.mean(error**2)) < 0.026
