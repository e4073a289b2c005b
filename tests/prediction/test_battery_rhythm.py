"""A battery's report says in which rows it was read, and is a straight line in between."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.model import EffectTerm, Estimate
from groundstation.prediction.drive import between_readings, drive_run, held, reading_rhythm
from support.flights import BASE, flown

ROWS = 4000


def report(stride, phase=0, seed=1):
    """A sinking voltage in whole millivolts, read every ``stride`` rows."""
    wander = np.cumsum(np.random.default_rng(seed).normal(0.0, 4e-4, ROWS))
    volts = np.round(4.0 - 2e-5 * np.arange(ROWS) + wander, 3)
    read = np.arange(phase, ROWS, stride)
    return held(volts[read], read, ROWS)


@pytest.mark.parametrize(("stride", "phase"), [(2, 1), (5, 0), (5, 3), (10, 7)])
def test_the_rows_of_the_readings_are_known_by_where_the_report_changes(stride, phase):
    found = reading_rhythm(report(stride, phase))
    assert (found.stride, found.phase) == (stride, phase)


@pytest.mark.parametrize("shown", [report(1), np.full(ROWS, 3.7), report(5)[:200]])
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
