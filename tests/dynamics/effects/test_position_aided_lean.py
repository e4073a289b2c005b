"""Angles of an estimator that takes every push for a tilt: as the law and the stand-in have it."""

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.effect import FAR_M, Body, Reading
from groundstation.dynamics.model import model_vehicle
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.rotations import attitude_of_quaternion
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.evaluation import Evaluation
from groundstation.identification.likelihood.motion import Frame, point_of
from groundstation.identification.likelihood.problem import BASE_KEYS, Problem
from groundstation.prediction.prediction import predict_ahead
from groundstation.telemetry.packet import STANDARD_GRAVITY
from support.flights import BASE, affected, flown

EFFECT = EFFECTS["position_aided_lean"]
HIDDEN = {
    "position_aided_lean": {"strength": 0.9, "time_s": 0.35},
    "rotor_drag": {"drag_n_s_m": 0.012},
}
STRENGTH, TIME = "position_aided_lean.strength", "position_aided_lean.time_s"
STILL, FOUR = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def leaning():
    return flown(60.0, 5, effects=HIDDEN)


def leant(seconds, force, strength=1.0, time_s=0.4, step=1e-3):
    """(roll, pitch) in rad after a constant specific force."""
    state = np.zeros(4)
    body = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), STILL, STILL, FOUR, FOUR, 0.0, STILL, force)
    for _ in range(round(seconds / step)):
        _, slopes = EFFECT.law((strength, time_s), None, body, Reading(STILL, force, FOUR), state)
        state += step * np.array(slopes)
    return state[0], state[1]


def test_a_lasting_push_is_taken_for_the_tilt_that_would_make_it():
    """Pushed to the left a craft seems to lean left down, pushed forward nose down."""
    roll, pitch = leant(5.0, (0.5, 0.3, 9.8))
    assert roll == pytest.approx(-0.3 / STANDARD_GRAVITY, rel=1e-3)
    assert pitch == pytest.approx(0.5 / STANDARD_GRAVITY, rel=1e-3)


def test_it_takes_two_time_constants_for_six_tenths():
    roll, _ = leant(0.8, (0.0, 1.0, 9.8))
    assert roll * STANDARD_GRAVITY == pytest.approx(-(1.0 - 3.0 * np.exp(-2.0)), rel=0.01)


def test_the_stand_in_leans_in_roll_and_pitch_and_keeps_its_heading(leaning):
    run, truth = leaning
    off = run.attitude - attitude_of_quaternion(truth["quaternion"])
    roll, pitch, yaw = np.sqrt(np.mean(np.angle(np.exp(1j * off)) ** 2, axis=0))
    assert min(roll, pitch) > 3.0 * yaw


def test_its_size_and_pace_are_fitted_to_a_flight(leaning):
    run, _ = leaning
    problem = Problem(prepare([run]), BASE, point_of(BASE))
    problem.settle_filters()
    keys = (*BASE_KEYS, STRENGTH, TIME, "rotor_drag.drag_n_s_m")
    start = {**problem.start, STRENGTH: 0.5, TIME: 0.6, "rotor_drag.drag_n_s_m": 0.006}
    problem.learn_noise(problem.linear(start, keys, problem.flights))
    fit = problem.fit(start, keys)
    for key, true, most in ((STRENGTH, 0.9, 0.05), (TIME, 0.35, 0.012)):
        error = fit.stderr()[key]
        assert error < most
        assert fit.point[key] == pytest.approx(true, abs=3.0 * error)
    assert fit.point["rotor_drag.drag_n_s_m"] == pytest.approx(0.012, rel=0.03)


def test_of_a_turned_sensor_thrust_across_its_axis_is_taken_for_a_push():
    """So on the mean a strength of 1 makes the angles the craft's own, not those of the sensor."""
    hidden = {**HIDDEN, "imu_misalignment": {"roll_deg": 4.0, "pitch_deg": -3.0, "yaw_deg": 0.0}}
    run, truth = flown(20.0, 6, effects=hidden)
    craft = attitude_of_quaternion(truth["quaternion"])
    terms = [affected(name, values).effects[0] for name, values in hidden.items()]
    model = msgspec.structs.replace(BASE, effects=tuple(terms))
    (flight,) = prepare([run])
    off = Evaluation(flight, Frame(model_vehicle(model)), point_of(model)).felt.off[flight.rows]
    angles = (run.attitude - craft[: len(run)])[flight.rows, :2]
    left = 1.0 - HIDDEN["position_aided_lean"]["strength"]
    np.testing.assert_allclose(
        np.degrees(angles.mean(axis=0)), left * np.array((4.0, -3.0)), atol=0.1
    )
    sensor = np.degrees((angles - off[:, :2]).mean(axis=0))
    np.testing.assert_allclose(sensor, (4.0, -3.0), atol=0.1)


def test_angles_are_foretold_from_where_the_estimator_has_them(leaning):
    run, _ = leaning
    drag = affected("rotor_drag", HIDDEN["rotor_drag"])
    lean = affected("position_aided_lean", HIDDEN["position_aided_lean"])
    both = msgspec.structs.replace(drag, effects=(*drag.effects, *lean.effects))

    def error(model):
        found = predict_ahead(model, run, (10, 25)).errors(run)
        return np.sqrt(np.mean(found[..., 6:8] ** 2))

    assert error(both) < 0.8 * error(drag)
