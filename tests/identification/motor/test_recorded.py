"""What of a recording a motor is fitted to."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.identification.motor.workflow import motor_runs
from support.flights import recorded


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
