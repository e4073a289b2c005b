"""Attitude: Euler angles ZYX, rotation matrices, quaternions and rates (thesis 3.3-3.11).

Roll phi about x (left side up positive), pitch theta about y (nose down positive), yaw psi about
z (counter-clockwise positive); ``R`` turns body vectors (FLU) into inertial ones (ENU). The order
is always (roll, pitch, yaw): thesis eq. 3.2 and 3.22 print the reverse, its matrices do not.
Every function works on any leading shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from groundstation.telemetry.arrays import Array


def rotation_matrix(attitude: ArrayLike) -> Array:
    """R(phi, theta, psi) = Rz Ry Rx (thesis eq. 3.6), (..., 3) rad to (..., 3, 3)."""
    roll, pitch, yaw = _columns(attitude)
    cr, sr = np.cos(roll), np.sin(roll)
    cp, sp = np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return _matrix(
        (cp * cy, cy * sp * sr - cr * sy, cr * cy * sp + sr * sy),
        (cp * sy, cr * cy + sp * sr * sy, cr * sp * sy - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def attitude_of_matrix(matrix: ArrayLike) -> Array:
    """Roll, pitch, yaw (rad) of rotation matrices (..., 3, 3); the inverse of eq. 3.6."""
    r = np.asarray(matrix, np.float64)
    return np.stack(
        [
            np.arctan2(r[..., 2, 1], r[..., 2, 2]),
            np.arcsin(np.clip(-r[..., 2, 0], -1.0, 1.0)),
            np.arctan2(r[..., 1, 0], r[..., 0, 0]),
        ],
        axis=-1,
    )


def rates_matrix(attitude: ArrayLike) -> Array:
    """W with body rates = W x Euler rates (thesis eq. 3.10), shape (..., 3, 3)."""
    roll, pitch, _ = _columns(attitude)
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    zero, one = np.zeros_like(roll), np.ones_like(roll)
    return _matrix((one, zero, -sp), (zero, cr, cp * sr), (zero, -sr, cp * cr))


def body_rates(attitude: ArrayLike, euler_rates: ArrayLike) -> Array:
    """Body rates p, q, r from Euler rates, rad/s (thesis eq. 3.9)."""
    speeds = np.asarray(euler_rates, np.float64)[..., None]
    return (rates_matrix(attitude) @ speeds)[..., 0]


def euler_rates(attitude: ArrayLike, rates: ArrayLike) -> Array:
    """Euler rates from body rates, rad/s (thesis eq. 3.11). Infinite at a pitch of +-90 deg."""
    roll, pitch, _ = _columns(attitude)
    p, q, r = _columns(rates)
    cr, sr = np.cos(roll), np.sin(roll)
    across = q * sr + r * cr
    return np.stack([p + np.tan(pitch) * across, q * cr - r * sr, across / np.cos(pitch)], axis=-1)


def quaternion_of_attitude(attitude: ArrayLike) -> Array:
    """Unit quaternion (w, x, y, z), body to inertial, of Euler angles; (..., 3) to (..., 4)."""
    roll, pitch, yaw = (0.5 * angle for angle in _columns(attitude))
    cr, sr = np.cos(roll), np.sin(roll)
    cp, sp = np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def matrix_of_quaternion(quaternion: ArrayLike) -> Array:
    """Rotation matrix (..., 3, 3), body to inertial, of unit quaternions (..., 4)."""
    w, x, y, z = _columns(quaternion)
    return _matrix(
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def attitude_of_quaternion(quaternion: ArrayLike) -> Array:
    """Roll, pitch, yaw (rad) of unit quaternions, (..., 4) to (..., 3)."""
    return attitude_of_matrix(matrix_of_quaternion(quaternion))


def _columns(values: ArrayLike) -> tuple[Array, ...]:
    array = np.asarray(values, np.float64)
    return tuple(array[..., i] for i in range(array.shape[-1]))


def _matrix(*rows: tuple[Array, Array, Array]) -> Array:
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
