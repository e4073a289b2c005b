"""The reduced plant is the base model and nothing else: "clean" means clean."""

from __future__ import annotations

import math

import numpy as np
import pytest

from firmware_sim.settings import Loss
from groundstation.dynamics.model import THESIS
from groundstation.dynamics.vehicle import THESIS_MOTOR, load_vehicle
from support.plant import flown, fly, plant

DT = 0.002


def rotors_from_log(rows):
    """Mean square and final speed over each row's interval, from duty times battery alone."""
    armature = rows["motors"] / 4096 * rows["battery"][:, None]
    a0, a1, a2 = THESIS_MOTOR.a0, THESIS_MOTOR.a1, THESIS_MOTOR.a2
    n = np.zeros(4)
    mean_square, final = np.empty(armature.shape), np.empty(armature.shape)
    for k, u in enumerate(armature):
        root = np.sqrt(a1 * a1 + 4 * a2 * a0 * u)
        high, low = (root - a1) / (2 * a2), (-root - a1) / (2 * a2)
        ratio = (n - high) / (n - low)
        points = []
        for share in (0.0, 0.5, 1.0):
            r = ratio * np.exp(-root * share * DT)
            points.append((high - low * r) / (1 - r))
        n = points[2]
        mean_square[k] = (points[0] ** 2 + 4 * points[1] ** 2 + points[2] ** 2) / 6
        final[k] = n
    return mean_square, final


@pytest.fixture(scope="module")
def log():
    _, rows = flown(
        64.0, plant="reduced", seed=7, copies=1, loss=Loss(good_loss=0.0), device_clock_ppm=0.0
    )
    mean_square, final = rotors_from_log(rows)
    late = slice(3600, None)
    rates = np.radians(rows["gyro"] / 16.384)
    torques = np.column_stack(
        [
            mean_square[:, 3] - mean_square[:, 1],
            mean_square[:, 2] - mean_square[:, 0],
            mean_square @ np.array([-1, 1, -1, 1]),
        ]
    )
    return {
        "acceleration": np.diff(rates, axis=0)[3599:] / DT,
        "torque": torques[late],
        "torque_before": torques[3599:-1],
        "force": rows["accelerometer"][late, 2] / 4096 * 9.80665,
        "in_plane": rows["accelerometer"][late, :2] / 4096 * 9.80665,
        "thrust": (final[late] ** 2).sum(axis=1),
        "rates": rates[late],
        "angles": np.radians(rows["angles"][late] / 100),
    }


@pytest.mark.parametrize(("axis", "name"), [(0, "c0"), (1, "c1"), (2, "c2")])
def test_the_rates_follow_the_rotors_of_the_same_row_without_delay(log, axis, name):
    torque = log["torque"][:, axis]
    # A delay d of the gyro would show as -d times the torque's rate of change.
    change = (torque - log["torque_before"][:, axis]) / DT
    regressors = np.column_stack([torque, -change])
    found, *_ = np.linalg.lstsq(regressors, log["acceleration"][:, axis], rcond=None)
    residual = log["acceleration"][:, axis] - regressors @ found
    covariance = np.linalg.inv(regressors.T @ regressors) * residual.var()
    truth = dict(zip(("c0", "c1", "c2"), load_vehicle("crazyflie1").body_constants, strict=True))
    assert found[0] == pytest.approx(truth[name], rel=0.01)
    delay, uncertainty = found[1] / found[0], math.sqrt(covariance[1, 1]) / found[0]
    assert abs(delay) < 3.5 * uncertainty
    assert uncertainty < 0.3e-3


def test_the_force_is_the_thrust_of_the_rotors_along_z(log):
    body = THESIS.body
    assert body is not None
    found = (log["force"] @ log["thrust"]) / (log["thrust"] @ log["thrust"])
    assert found == pytest.approx(body.thrust_per_mass, rel=4e-4)  # noise: 1e-4
    assert np.abs(log["in_plane"].mean(axis=0)).max() < 0.01
    correlation = np.corrcoef(log["in_plane"][:, 0], log["rates"][:, 1])[0, 1]
    assert abs(correlation) < 0.03


def test_the_angles_are_those_of_the_rates_by_exact_kinematics(log):
    """thesis eq. 3.11 over each pair of rows; the packet's pitch is nose up."""
    roll, pitch, yaw = log["angles"].T * np.array([[1], [-1], [1]])
    p, q, r = ((log["rates"][:-1] + log["rates"][1:]) / 2).T
    phi, theta = roll[:-1], pitch[:-1]
    rates = np.column_stack(
        [
            p + (np.sin(phi) * q + np.cos(phi) * r) * np.tan(theta),
            np.cos(phi) * q - np.sin(phi) * r,
            (np.sin(phi) * q + np.cos(phi) * r) / np.cos(theta),
        ]
    )
    fresh = int(np.flatnonzero(np.diff(roll[:50]))[0]) + 1
    turned = np.cumsum(rates, axis=0) * DT
    for axis, angle in enumerate((roll, pitch, np.unwrap(yaw))):
        change = np.diff(angle[fresh::2])
        predicted = np.diff(turned[fresh - 1 :: 2, axis])[: len(change)]
        slope = (change[: len(predicted)] @ predicted) / (predicted @ predicted)
        assert slope == pytest.approx(1.0, abs=0.03)


def test_a_finer_step_changes_nothing_that_noise_would_not_hide():
    finals = []
    for substeps in (4, 64):
        p, s = plant(plant="reduced", substeps=substeps)
        s["y"][0, 10:13] = 2.0, -1.5, 1.0
        s["y"][0, 13:17] = 240.0, 250.0, 230.0, 245.0
        for step in range(250):
            s["duty"][0] = 0.6 + 0.2 * np.sin([step, 2.0 * step, 3.0 * step, 0.5 * step])
            s["supply_mv"] = 3700.0
            fly(p, s, DT, chunk_s=DT)
        finals.append(s["y"][0].copy())
    assert np.abs(finals[0] - finals[1])[10:13].max() < 1e-9  # a gyro count is 1e-3 rad/s
    assert np.abs(finals[0] - finals[1])[13:17].max() < 1e-7
