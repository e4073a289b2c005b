"""The estimator that a Flow deck needs: position, velocity and attitude from gyro and sensors.

An extended Kalman filter with the states, noises and rates of the firmware: position (m, world),
velocity (m/s, body) and an attitude error (rad, body) that is put into the quaternion at once. In
flight it takes of the accelerometer only what is along the rotors' axis, and expects no drag unless
``kalman.dragB_x`` and ``dragB_y`` say so. So it reads a steady drag as a tilt of its own: a craft
that it calls level leans by drag / g and keeps its speed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_sim.compiled import inner
from firmware_sim.flow_deck import PIXELS_PER_RAD, measure_flow, measure_range, widened
from firmware_sim.layout import PASS_NS, Record
from firmware_sim.supervisor import FLYING, LEVEL_OUT

STATES, VELOCITY, TILT = 9, 3, 6
"""Positions come first."""
STEP_PASSES, RANGE_PASSES = 5, 13
"""Passes between two predictions, and flows, (100 Hz) and between two ranges (26 ms)."""
STEP_S = STEP_PASSES * PASS_NS * 1e-9
G = 9.81
"""The firmware's, m/s^2."""
RADIANS = math.pi / 180.0

FIRST_STD = (100.0, 100.0, 1.0, 0.01, 0.01, 0.01, 0.01, 0.01, 0.01)
"""At the start: m, m/s, rad."""
SPEED_NOISE, CLIMB_NOISE, TURN_NOISE = 2.5e-4, 1e-3, 1e-5
"""Growth of variances a second: accelerations of 0.5 and 1 m/s^2 and a rate of 0.1 rad/s, each new
every ms."""
LEAST_VARIANCE, MOST_VARIANCE = 1e-6, 100.0
FLOW_STD, RANGE_STD_M = 0.2, 0.0025
"""What the filter thinks of a flow (pixels) and of a range."""
LEAST_HEIGHT_M = 0.1
"""Flow is read as if never lower."""
REVERSION = 0.001
"""On the ground the attitude goes back to the first one by so much a step."""
MOST_M, MOST_M_S = 100.0, 10.0
"""Beyond, the filter begins anew."""


@inner
def begin(fw: Record) -> None:
    """The state at power-on: at the origin, level, at rest."""
    for i in range(STATES):
        for j in range(STATES):
            fw.kalman_variance[i, j] = FIRST_STD[i] * FIRST_STD[i] if i == j else 0.0
    for i in range(6):
        fw.kalman_state[i] = 0.0
    for i in range(4):
        fw.quaternion[i] = 1.0 if i == 0 else 0.0
    for i in range(3):
        fw.kalman_sum[0, i] = fw.kalman_sum[1, i] = 0.0
    fw.kalman_reset = 0


@inner
def estimate(p: Record, fw: Record, s: Record, index: int) -> None:
    """One pass: leaves ``fw.place``, and ``fw.angles`` where those are not the plant's.

    index: of the pass since power-on.
    """
    if fw.kalman_reset != 0:
        begin(fw)
    for i in range(3):
        fw.kalman_sum[0, i] += fw.accel[i] * G / STEP_PASSES
        fw.kalman_sum[1, i] += fw.gyro[i] * RADIANS / STEP_PASSES
    steps, ranges = index % STEP_PASSES == 0, index % RANGE_PASSES == 0
    if not (steps or ranges):
        return
    if steps:
        _predict(fw, fw.supervisor in (FLYING, LEVEL_OUT))
        _take_flow(p, fw, s)
    if ranges:
        _take_range(p, fw, s)
    _tell(p, fw)


@inner
def _predict(fw: Record, flies: bool) -> None:
    """A step on, by what gyro and accelerometer said since the last."""
    x, turn = fw.kalman_state, fw.kalman_sum[1]
    rotation = _rotation(fw)
    _grow(fw, rotation, flies)
    felt = np.zeros(3)
    felt[2] = fw.kalman_sum[0, 2]
    vx, vy, vz = x[3], x[4], x[5]
    if flies:
        felt[0], felt[1] = -fw.kalman_drag[0] * vx, -fw.kalman_drag[1] * vy
    else:
        felt[0], felt[1] = fw.kalman_sum[0, 0], fw.kalman_sum[0, 1]
    for i in range(3):
        along = vx * rotation[i, 0] + vy * rotation[i, 1] + vz * rotation[i, 2]
        x[i] += STEP_S * along
    x[3] += STEP_S * (felt[0] + turn[2] * vy - turn[1] * vz - G * rotation[2, 0])
    x[4] += STEP_S * (felt[1] - turn[2] * vx + turn[0] * vz - G * rotation[2, 1])
    x[5] += STEP_S * (felt[2] + turn[1] * vx - turn[0] * vy - G * rotation[2, 2])
    _turn(fw, STEP_S * turn[0], STEP_S * turn[1], STEP_S * turn[2])
    if not flies:
        for i in range(4):
            fw.quaternion[i] += REVERSION * ((1.0 if i == 0 else 0.0) - fw.quaternion[i])
    for i in range(3):
        fw.kalman_sum[0, i] = fw.kalman_sum[1, i] = 0.0


@inner
def _grow(fw: Record, rotation: Any, flies: bool) -> None:
    """The covariance a step on: F P F' + Q."""
    x, turn, variance = fw.kalman_state, fw.kalman_sum[1], fw.kalman_variance
    step = np.eye(STATES)
    for i in range(3):
        for j in range(3):
            step[i, VELOCITY + j] = STEP_S * rotation[i, j]
            left, right = (j + 1) % 3, (j + 2) % 3
            step[i, TILT + j] = STEP_S * (
                x[3 + left] * rotation[i, right] - x[3 + right] * rotation[i, left]
            )
    _cross(step, VELOCITY, VELOCITY, turn[0], turn[1], turn[2])
    _cross(step, TILT, TILT, turn[0], turn[1], turn[2])
    _cross(step, VELOCITY, TILT, G * rotation[2, 0], G * rotation[2, 1], G * rotation[2, 2])
    if flies:
        for i in range(2):
            step[VELOCITY + i, VELOCITY + i] -= STEP_S * fw.kalman_drag[i]
    half = np.zeros((STATES, STATES))
    for i in range(STATES):
        for k in range(STATES):
            if step[i, k] != 0.0:
                for j in range(STATES):
                    half[i, j] += step[i, k] * variance[k, j]
    for i in range(STATES):
        for j in range(i, STATES):
            total = 0.0
            for k in range(STATES):
                total += half[i, k] * step[j, k]
            variance[i, j] = variance[j, i] = total
    for i in range(3):
        variance[3 + i, 3 + i] += STEP_S * (CLIMB_NOISE if i == 2 else SPEED_NOISE)
        variance[6 + i, 6 + i] += STEP_S * TURN_NOISE
    _bound(variance)


@inner
def _cross(step: Any, row: int, column: int, x: float, y: float, z: float) -> None:
    """Add -[v] of a cross product, times a step."""
    step[row, column + 1] += STEP_S * z
    step[row, column + 2] -= STEP_S * y
    step[row + 1, column] -= STEP_S * z
    step[row + 1, column + 2] += STEP_S * x
    step[row + 2, column] += STEP_S * y
    step[row + 2, column + 1] -= STEP_S * x


@inner
def _take_flow(p: Record, fw: Record, s: Record) -> None:
    """What the ground moved by in the camera, ahead and to the left."""
    seen, ahead, aside = measure_flow(p, s, STEP_S)
    if not seen:
        return
    per_rad = PIXELS_PER_RAD * STEP_S
    for i in range(2):
        upright = _rotation(fw)[2, 2]
        height = max(fw.kalman_state[2], LEAST_HEIGHT_M)
        turned = fw.gyro[0] * RADIANS if i == 1 else -fw.gyro[1] * RADIANS
        flow = per_rad * (fw.kalman_state[3 + i] * upright / height + turned)
        model = np.zeros(STATES)
        model[2] = -per_rad * fw.kalman_state[3 + i] * upright / (height * height)
        model[3 + i] = per_rad * upright / height
        _correct(fw, model, (ahead if i == 0 else aside) - flow, FLOW_STD)


@inner
def _take_range(p: Record, fw: Record, s: Record) -> None:
    measure_range(p, fw, s, True)
    upright = _rotation(fw)[2, 2]
    if upright > 0.1:
        model = np.zeros(STATES)
        model[2] = widened(upright)
        _correct(fw, model, fw.range_m - model[2] * fw.kalman_state[2], RANGE_STD_M)


@inner
def _correct(fw: Record, model: Any, error: float, std: float) -> None:
    """Take one number: ``error`` from what ``model`` times the state says it should be."""
    variance = fw.kalman_variance
    shared, total = np.zeros(STATES), std * std
    for i in range(STATES):
        for j in range(STATES):
            shared[i] += variance[i, j] * model[j]
        total += model[i] * shared[i]
    for i in range(6):
        fw.kalman_state[i] += shared[i] / total * error
    _turn(fw, shared[TILT] / total * error, shared[7] / total * error, shared[8] / total * error)
    for i in range(STATES):
        for j in range(STATES):
            variance[i, j] -= shared[i] * shared[j] / total
    _bound(variance)


@inner
def _bound(variance: Any) -> None:
    for i in range(STATES):
        variance[i, i] = max(variance[i, i], LEAST_VARIANCE)
        for j in range(STATES):
            variance[i, j] = min(variance[i, j], MOST_VARIANCE)


@inner
def _turn(fw: Record, x: float, y: float, z: float) -> None:
    """Turn the attitude by a rotation (rad) about the body's axes."""
    q = fw.quaternion
    angle = math.sqrt(x * x + y * y + z * z)
    share = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    c, x, y, z = math.cos(0.5 * angle), share * x, share * y, share * z
    w, a, b, d = q[0], q[1], q[2], q[3]
    q[0] = w * c - a * x - b * y - d * z
    q[1] = w * x + a * c + b * z - d * y
    q[2] = w * y + b * c + d * x - a * z
    q[3] = w * z + d * c + a * y - b * x
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] /= norm


@inner
def _rotation(fw: Record) -> Any:
    """Body to world."""
    w, a, b, c = fw.quaternion[0], fw.quaternion[1], fw.quaternion[2], fw.quaternion[3]
    out = np.empty((3, 3))
    out[0, 0], out[0, 1] = 1 - 2 * (b * b + c * c), 2 * (a * b - w * c)
    out[0, 2], out[1, 0] = 2 * (a * c + w * b), 2 * (a * b + w * c)
    out[1, 1], out[1, 2] = 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)
    out[2, 0], out[2, 1] = 2 * (a * c - w * b), 2 * (b * c + w * a)
    out[2, 2] = 1 - 2 * (a * a + b * b)
    return out


@inner
def _tell(p: Record, fw: Record) -> None:
    """What the rest of the firmware, and its log, know of it."""
    x = fw.kalman_state
    rotation = _rotation(fw)
    heading = math.atan2(rotation[1, 0], rotation[0, 0])
    if p.ideal_attitude != 0:
        # the plant's angles count: only the frame of position and velocity is the filter's
        _turn_world(fw, fw.angles[2] * RADIANS - heading)
        rotation = _rotation(fw)
    else:
        fw.angles[0] = math.atan2(rotation[2, 1], rotation[2, 2]) / RADIANS
        fw.angles[1] = math.asin(min(max(rotation[2, 0], -1.0), 1.0)) / RADIANS
        fw.angles[2] = heading / RADIANS
    lost = False
    for i in range(3):
        fw.place[i] = x[i]
        fw.place[3 + i] = rotation[i, 0] * x[3] + rotation[i, 1] * x[4] + rotation[i, 2] * x[5]
        fw.place_variance[i] = fw.kalman_variance[i, i]
        fw.place_variance[3 + i] = fw.kalman_variance[3 + i, 3 + i]
        lost = lost or abs(x[i]) > MOST_M or abs(x[3 + i]) > MOST_M_S
    fw.height, fw.climb = fw.place[2], fw.place[5]
    if lost:
        fw.kalman_reset = 1
        fw.kalman_resets += 1


@inner
def _turn_world(fw: Record, angle: float) -> None:
    """Turn the attitude about the vertical, rad."""
    q = fw.quaternion
    c, z = math.cos(0.5 * angle), math.sin(0.5 * angle)
    w, a, b, d = q[0], q[1], q[2], q[3]
    q[0], q[1], q[2], q[3] = c * w - z * d, c * a - z * b, c * b + z * a, c * d + z * w
