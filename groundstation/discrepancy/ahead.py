"""Prediction 20 and 50 ms ahead by the base model; replaced by dynamics' predict_ahead."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.regimes import Motion
from groundstation.dynamics.rotations import attitude_of_quaternion, quaternion_of_attitude
from groundstation.identification.runs import Run

Array = NDArray[np.float64]


def base_ahead(run: Run, motion: Motion, rows: int) -> Array:
    """(n, 9): row k as predicted from row k - rows; NaN in the first rows."""
    n, dt = len(run), run.period_s
    out = np.full((n, 9), np.nan)
    gain = np.vstack([np.zeros(3), np.cumsum(motion.torque, axis=0)]) * dt
    start = run.gyro[: n - rows]
    q = quaternion_of_attitude(run.attitude[: n - rows])
    rate = start
    for j in range(1, rows + 1):
        after = start + gain[1 + j : 1 + j + n - rows] - gain[1 : 1 + n - rows]
        q = _turned(q, 0.5 * (rate + after) * dt)
        rate = after
    out[rows:, :3] = rate
    out[rows:, 3:5] = 0.0
    out[rows:, 5] = motion.thrust[rows:]
    angles = attitude_of_quaternion(q)
    angles += 2 * np.pi * np.round((run.attitude[rows:] - angles) / (2 * np.pi))
    out[rows:, 6:] = angles
    return out


def _turned(q: Array, angle: Array) -> Array:
    size = np.linalg.norm(angle, axis=1)
    half = 0.5 * size
    v = angle * (0.5 * np.sinc(half / np.pi))[:, None]
    w = np.cos(half)
    w0, v0 = q[:, 0], q[:, 1:]
    out = np.empty_like(q)
    out[:, 0] = w0 * w - (v0 * v).sum(axis=1)
    out[:, 1:] = w0[:, None] * v + w[:, None] * v0 + np.cross(v0, v)
    return out
