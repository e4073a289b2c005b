"""The velocity with which a recording begins in the air, from the seconds that follow."""

import numpy as np
import pytest

from groundstation.dynamics.rotations import rotation_matrix
from groundstation.prediction.prediction import observe_run, start_velocity
from groundstation.telemetry.packet import STANDARD_GRAVITY
from support.flights import BASE, flown

PERIOD, SPEED, RADIUS = 0.002, 1.5, 0.8


@pytest.fixture(scope="module")
def circle():
    """(attitude, specific force, inertial velocity) of 8 s along a circle, banked, nose forward."""
    turn = SPEED / RADIUS
    heading = turn * PERIOD * np.arange(4000)
    bank = np.full(len(heading), -np.arctan(SPEED * turn / STANDARD_GRAVITY))
    attitude = np.column_stack([bank, np.zeros_like(bank), heading])
    force = np.tile([0.0, 0.0, np.hypot(SPEED * turn, STANDARD_GRAVITY)], (len(heading), 1))
    return attitude, force, SPEED * np.column_stack([np.cos(heading), np.sin(heading), 0 * heading])


def test_a_craft_that_circles_is_known_to_fly_at_its_speed(circle):
    attitude, force, velocity = circle
    found = start_velocity(attitude, force, PERIOD)
    # Two rounds and a half: what the last half moves it is left.
    assert np.linalg.norm(found - velocity[0]) < 2.2 * RADIUS / (len(force) * PERIOD)


def test_rows_that_are_missing_change_little(circle):
    attitude, force, _ = (rows.copy() for rows in circle)
    whole = start_velocity(attitude, force, PERIOD)
    attitude[7::3], force[5::11] = np.nan, np.nan
    np.testing.assert_allclose(start_velocity(attitude, force, PERIOD), whole, atol=0.01)


def test_of_a_second_or_without_an_accelerometer_nothing_is_said(circle):
    attitude, force, _ = circle
    assert not start_velocity(attitude[:500], force[:500], PERIOD).any()
    assert not start_velocity(attitude, np.full_like(force, np.nan), PERIOD).any()


@pytest.fixture(scope="module")
def in_motion():
    """(run, true inertial velocity) of a stand-in's flight, cut where it moves fastest."""
    run, truth = flown(60.0, 3, "rotor_drag")
    velocity = truth["velocity_m_s"][: len(run)]
    level = np.hypot(velocity[:, 0], velocity[:, 1])
    first = 5000 + int(np.argmax(level[5000:-6000]))
    return run[first:], velocity[first:]


def test_the_observer_begins_with_it(in_motion):
    run, true = in_motion
    seen = observe_run(BASE, run)
    assert np.hypot(*true[0, :2]) > 0.7
    away = np.linalg.norm(seen.states[0, 3:5] - true[0, :2])
    assert away < 0.5 * np.hypot(*true[0, :2])
    # And as rows go on it is no further off than one that begins at rest would be by half.
    inside = seen.states[:2000, 3:5] - true[:2000, :2]
    assert np.sqrt(np.mean(np.sum(inside**2, axis=1))) < 0.5 * np.hypot(*true[0, :2])


def test_one_that_begins_on_the_ground_begins_at_rest():
    run, _ = flown(12.0, 4)
    assert not observe_run(BASE, run).states[0, 3:6].any()


def test_the_circles_bank_and_force_are_those_of_level_flight(circle):
    attitude, force, velocity = circle
    felt = np.einsum("nij,nj->ni", rotation_matrix(attitude), force)
    slope = np.gradient(velocity, PERIOD, axis=0)
    np.testing.assert_allclose(felt[5:-5, :2], slope[5:-5, :2], atol=0.02)
    np.testing.assert_allclose(felt[:, 2], STANDARD_GRAVITY, rtol=1e-9)
