"""What flights, or parts of one, differ by is part of the errors that are stated."""

import math

import numpy as np
import pytest

from groundstation.discrepancy.recurrence import (
    DELAY,
    UNMEASURED_MOTORS,
    UNWEIGHED,
    Blocks,
    difference,
    with_differences,
    with_open_delay,
    with_unmeasured,
)

BLOCKS = 20


def told(sizes, trust=100.0):
    """(trust, score) of blocks that tell these sizes, counted from the joint one."""
    return np.full(len(sizes), trust), trust * np.asarray(sizes)


def two_flights(count=BLOCKS):
    return np.repeat([0, 1], count // 2)


def test_flights_that_differ_by_more_than_noise_widen_the_error_of_their_mean():
    apart = np.where(two_flights() == 0, -0.2, 0.2)
    assert difference(*told(apart), two_flights()) == pytest.approx(0.2, rel=0.02)


def test_flights_that_agree_within_noise_widen_nothing():
    assert difference(*told(np.tile([-0.1, 0.1], BLOCKS // 2)), two_flights()) == 0.0


def test_two_flights_that_happen_to_agree_differ_at_least_as_much_as_parts_of_one():
    """Blocks lie 0.3 apart where noise makes 0.1 of it; both flights have the same mean."""
    half = 0.3 * np.random.default_rng(5).standard_normal(BLOCKS // 2)
    wider = difference(*told(np.tile(half - half.mean(), 2)), two_flights())
    assert wider == pytest.approx(0.3 / np.sqrt(2.0), rel=0.3)


def test_of_one_flight_its_parts_tell_what_the_next_may_differ_by():
    parts = np.tile([-0.5, 0.5], BLOCKS // 2)
    wider = difference(*told(parts), np.zeros(BLOCKS, np.int64))
    assert wider == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_errors_hold_where_flights_differ(seed):
    """Of 200 pairs of flights whose sizes scatter by 0.3, and as much from block to block."""
    random = np.random.default_rng(seed)
    held = []
    for _ in range(200):
        sizes = 0.3 * (random.standard_normal(2)[two_flights()] + random.standard_normal(BLOCKS))
        sizes += 0.1 * random.standard_normal(BLOCKS)
        mean = sizes.mean()
        error = np.hypot(0.1 / np.sqrt(BLOCKS), difference(*told(sizes - mean), two_flights()))
        held.append(abs(mean) < 1.96 * error)
    assert np.mean(held) > 0.85


def test_what_the_prior_holds_is_widened_by_the_share_that_the_data_have():
    apart, flight = np.where(two_flights() == 0, -0.2, 0.2), two_flights()
    trust, score = told(apart)

    def stated(prior):
        whole = np.array([[prior]]), np.zeros(1)
        blocks = Blocks(("c0",), 1, trust[:, None, None], score[:, None], flight, whole)
        error = (trust.sum() + prior) ** -0.5
        return with_differences({"c0": error, "held": 1.0}, blocks), error

    free, error = stated(0.0)
    assert free["c0"] == pytest.approx(np.hypot(error, 0.2), rel=0.02)
    assert free["held"] == 1.0
    held, error = stated(99.0 * trust.sum())
    assert held["c0"] == pytest.approx(np.hypot(error, 0.002), rel=0.02)


def beside_a_delay(fitted):
    """Blocks of a number x and a delay whose columns overlap by half, ``fitted`` of them in the
    fit."""
    normal = np.tile([[100.0, 50.0], [50.0, 100.0]], (BLOCKS, 1, 1))
    nothing = np.zeros((2, 2)), np.zeros(2)
    return Blocks(("x", DELAY), fitted, normal, np.zeros((BLOCKS, 2)), two_flights(), nothing)


def test_a_delay_that_rows_leave_open_widens_what_it_would_move():
    wider = with_open_delay({"x": 0.3, "y": 0.2}, beside_a_delay(1), 0.8 * np.sqrt(3.0))
    assert wider == pytest.approx({"x": 0.5, "y": 0.2})


def test_a_fitted_delay_takes_what_is_open_upon_itself():
    wider = with_open_delay({"x": 0.3, DELAY: 0.6}, beside_a_delay(2), 0.8 * np.sqrt(3.0))
    assert wider == pytest.approx({"x": 0.3, DELAY: 1.0})


def test_rows_that_leave_no_delay_open_widen_nothing():
    assert with_open_delay({"x": 0.3}, beside_a_delay(1), 0.0) == {"x": 0.3}


def test_what_nothing_measured_is_in_the_errors_of_what_is_reckoned_by_it():
    point = {
        "rotor_acceleration_torque.rotor_inertia_kg_m2": 3e-8,
        "centre_of_gravity_offset.x_m": 2e-3,
        "imu_misalignment.roll_deg": 3.0,
        "c0": 0.002,
    }
    errors = dict.fromkeys(point, 0.0) | {DELAY: 0.0, "rotor_drag.drag_n_s_m": 1.0}
    point[DELAY] = 0.004

    def wider(**known):
        return with_unmeasured(errors, point, row_s=0.002, **known)

    nothing = wider(is_weighed=False, motors_known=False)
    inertia, offset, turned, constant = list(point)[:4]
    assert nothing[inertia] == pytest.approx(3e-8 * math.hypot(UNWEIGHED, UNMEASURED_MOTORS))
    assert nothing[offset] == pytest.approx(2e-3 * UNMEASURED_MOTORS)
    assert nothing[turned] == nothing[constant] == 0.0
    assert nothing[DELAY] == pytest.approx(0.002 / math.sqrt(12.0)), "anywhere within a row"
    assert nothing["rotor_drag.drag_n_s_m"] == 1.0, "what is not fitted stays as it is"
    everything = wider(is_weighed=True, motors_known=True)
    assert everything[inertia] == everything[offset] == 0.0
