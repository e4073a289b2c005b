"""What an unknown is said to add to a flight is what its residuals lose when it is moved."""

import numpy as np
import pytest

from groundstation.dynamics.model import model_vehicle
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.evaluation import evaluate
from groundstation.identification.likelihood.motion import BODY_KEYS, KEYS, Frame, point_of
from groundstation.identification.likelihood.problem import Problem
from support.flights import BASE, MEDIUM, flown

HIDDEN = {name: MEDIUM[name] for name in ("rotor_drag", "velocity_moment", "dead_time")}
AT = {
    "rotor_drag.drag_n_s_m": 0.011,
    "velocity_moment.moment": 14.0,
    "velocity_moment.asymmetry": 0.1,
    "dead_time.delay_s": 0.0049,
    "position_aided_lean.strength": 0.8,
    "position_aided_lean.time_s": 0.3,
    "accelerometer_bias.x_g": 0.02,
    "accelerometer_bias.y_g": -0.01,
    "accelerometer_bias.z_g": 0.01,
    "imu_misalignment.roll_deg": 1.0,
    "imu_misalignment.pitch_deg": -1.0,
    "imu_misalignment.yaw_deg": 2.0,
    "imu_lever_arm.x_m": 0.002,
    "imu_lever_arm.y_m": -0.001,
    "imu_lever_arm.z_m": 0.002,
    "rotor_acceleration_torque.rotor_inertia_kg_m2": 5e-8,
    "rate_damping.damping_n_m_s": 1e-5,
    "gyro_bias.x_dps": 0.5,
    "gyro_bias.y_dps": 0.5,
    "gyro_bias.z_dps": 0.5,
}
WITHIN = 0.1
"""Of a column; rates that are predicted with another model are not in it."""


@pytest.fixture(scope="module")
def flight():
    run, _ = flown(30.0, 6, effects=HIDDEN)
    (one,) = prepare([run[4000:]])  # it begins in the air
    return one


@pytest.mark.parametrize("key", [*AT, *BODY_KEYS])
def test_a_column_is_the_slope_of_the_residuals(flight, key):
    point, frame = {**point_of(BASE), **AT}, Frame(model_vehicle(BASE), BASE.motors)
    step = 1e-3 * point[key] if key in BODY_KEYS else 0.2 * KEYS[key].step
    above, below = (
        evaluate(flight, frame, {**point, key: point[key] + change}, ()).residual
        for change in (step, -step)
    )
    columns = evaluate(flight, frame, point, (key,)).columns[key]
    off, size = 0.0, 0.0
    for channel, rows in above.items():
        lost = (below[channel] - rows) / (2.0 * step)
        noise = np.mean(np.square(rows))
        size += np.mean(np.square(lost)) / noise
        off += np.mean(np.square(lost - columns.get(channel, 0.0))) / noise
    assert np.sqrt(off / size) < WITHIN


def test_a_fit_of_a_flight_that_begins_in_motion_invents_no_offsets(flight):
    """A wrong velocity would be a force of its own, which an offset takes away."""
    problem = Problem([flight], BASE, point_of(BASE))
    problem.settle_filters()
    offsets = [f"accelerometer_bias.{axis}_g" for axis in "xyz"]
    keys = (*problem.base_keys, *(key for key in AT if "rotor_drag" in key or "moment" in key))
    keys = (*keys, "dead_time.delay_s", *offsets)
    start = problem.start | {key: AT[key] for key in keys if key in AT and key not in offsets}
    start |= dict.fromkeys(offsets, 0.0)
    problem.learn_noise(problem.linear(start, keys, problem.flights))
    found = problem.fit(start, keys)
    for key in offsets:
        assert abs(found.point[key]) < max(0.005, 4.0 * found.stderr()[key]), key
    assert found.point["rotor_drag.drag_n_s_m"] == pytest.approx(0.012, rel=0.1)
