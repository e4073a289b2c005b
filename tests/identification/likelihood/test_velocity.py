"""The velocity behind a flight's residuals, beside the stand-in's own."""

import numpy as np
import pytest

from groundstation.dynamics.model import model_vehicle
from groundstation.dynamics.rotations import attitude_of_quaternion, rotation_matrix
from groundstation.identification.flight import prepare, velocity_of
from groundstation.identification.likelihood.evaluation import generic_signals
from groundstation.identification.likelihood.motion import Frame, point_of
from support.flights import BASE, flown

AXES = ("forward", "leftward", "upward")


@pytest.fixture(scope="module")
def flight():
    return flown(30.0, 3, "rotor_drag")


def off(run, truth, first):
    """(RMS error, RMS) of the velocity (3,) in the first 4 s of a flight, m/s in body axes."""
    (one,) = prepare([run])
    signals = generic_signals(one, Frame(model_vehicle(BASE), BASE.motors), point_of(BASE))
    rows = np.arange(one.first, one.first + 2000)
    found = np.column_stack([signals[f"the {axis} velocity"] for axis in AXES])[rows]
    turned = rotation_matrix(attitude_of_quaternion(truth["quaternion"][rows + first]))
    true = np.einsum("nji,nj->ni", turned, truth["velocity_m_s"][rows + first])
    return np.sqrt(np.mean((found - true) ** 2, axis=0)), np.sqrt(np.mean(true**2, axis=0))


def test_it_is_integrated_from_the_ground_through_the_climb(flight):
    error, size = off(*flight, 0)
    assert size[2] > 0.1
    assert error.max() < 0.1


def test_a_flight_that_begins_in_motion_begins_with_it(flight):
    run, truth = flight
    speed = np.hypot(*truth["velocity_m_s"][5000 : len(run) - 5000, :2].T)
    first = 5000 + int(np.argmax(speed))
    error, size = off(run[first:], truth, first)
    assert np.hypot(*error[:2]) < 0.3 * np.hypot(*size[:2])


def test_a_run_that_begins_in_motion_begins_with_it(flight):
    run, truth = flight
    first = 5000 + int(np.argmax(np.hypot(*truth["velocity_m_s"][5000 : len(run) - 5000, :2].T)))
    rows = slice(first, first + 1000)
    turned = rotation_matrix(attitude_of_quaternion(truth["quaternion"][rows]))
    true = np.einsum("nji,nj->ni", turned, truth["velocity_m_s"][rows])[:, :2]
    found = velocity_of(run[first:])[:1000, :2]
    assert np.linalg.norm(found - true) < 0.4 * np.linalg.norm(true)
