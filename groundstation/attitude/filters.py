"""Sensor fusion: complementary and Kalman filter (thesis 6.2). Roll and pitch are referred to
the earth by the accelerometer, yaw is relative to the start and drifts with the gyro's offset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from groundstation.attitude.sensors import accelerometer_attitude
from groundstation.telemetry.arrays import Array

START_ROWS = 25
"""The first attitude is the accelerometer's mean over so many rows (50 ms)."""


@dataclass(frozen=True, slots=True)
class KalmanNoise:
    """Noise of the Kalman filter (thesis eq. 6.21; there without units).

    angle, bias: the diagonal of Q, added at every step, deg^2 and (deg/s)^2.
    accelerometer: R, deg^2.

    The estimate depends on the ratios to R only, so with all three in rad it is the same.
    The thesis's values belong to steps of 2 ms.
    """

    angle: float = 0.001
    bias: float = 0.001
    accelerometer: float = 5.0


@dataclass(frozen=True, slots=True)
class KalmanEstimate:
    """Outcome of ``kalman``.

    attitude: (n, 3) roll, pitch, yaw in rad. bias: (n, 3) offsets of the Euler rates, rad/s.
    """

    attitude: Array
    bias: Array


def complementary(
    time_s: ArrayLike, gyro: ArrayLike, accelerometer: ArrayLike, weight: float = 0.998
) -> Array:
    """Attitude (n, 3) in rad by the complementary filter (thesis eq. 6.7-6.10).

    time_s: (n,). gyro: (n, 3) rad/s. accelerometer: (n, 3), any unit. weight: W, 0..1, of the
    gyro; with steps of 2 ms the default trusts the accelerometer over about a second.

    Raises ValueError for a weight outside 0..1 and for shapes that do not fit.
    """
    from groundstation.attitude.kernels import complement

    if not 0.0 <= weight <= 1.0:
        raise ValueError(f"weight {weight} is outside 0..1")
    time, rates, tilt = _inputs(time_s, gyro, accelerometer)
    angles = np.empty((len(time), 3))
    complement(time, rates, tilt, _start(accelerometer), weight, angles)
    return angles


def kalman(
    time_s: ArrayLike,
    gyro: ArrayLike,
    accelerometer: ArrayLike,
    noise: KalmanNoise | None = None,
) -> KalmanEstimate:
    """Attitude and gyro offsets by one two-state Kalman filter per axis (eq. 6.11-6.20).

    The input is the Euler rate from the gyro (6.3), the measurement the accelerometer's angle.
    Yaw has no measurement: its bias stays zero, and an offset of the gyro drifts into it. Subtract
    ``sensors.rest_bias`` from the gyro where the recording starts at rest.

    time_s: (n,). gyro: (n, 3) rad/s. accelerometer: (n, 3), any unit.
    """
    from groundstation.attitude.kernels import kalman_axes

    chosen = noise or KalmanNoise()
    time, rates, tilt = _inputs(time_s, gyro, accelerometer)
    attitude, bias = np.empty((len(time), 3)), np.empty((len(time), 3))
    # One scale for all: radians inside, ratios as given.
    unit = np.radians(1.0) ** 2
    kalman_axes(
        time,
        rates,
        tilt,
        _start(accelerometer),
        chosen.angle * unit,
        chosen.bias * unit,
        chosen.accelerometer * unit,
        attitude,
        bias,
    )
    return KalmanEstimate(attitude, bias)


def _inputs(
    time_s: ArrayLike, gyro: ArrayLike, accelerometer: ArrayLike
) -> tuple[Array, Array, Array]:
    time = np.ascontiguousarray(time_s, np.float64)
    rates = np.ascontiguousarray(gyro, np.float64)
    force = np.asarray(accelerometer, np.float64)
    if time.ndim != 1 or rates.shape != (len(time), 3) or force.shape != rates.shape:
        raise ValueError(
            f"time {time.shape}, gyro {rates.shape}, accelerometer {force.shape}:"
            " need (n,), (n, 3), (n, 3)"
        )
    if len(time) < 2:
        raise ValueError("sensor fusion needs at least two rows")
    return time, rates, np.ascontiguousarray(accelerometer_attitude(force))


def _start(accelerometer: ArrayLike) -> Array:
    """Eq. 6.7, from the mean force so that noise and the wrap of roll do not matter."""
    force = np.asarray(accelerometer, np.float64)[:START_ROWS].mean(axis=0)
    return np.array([*accelerometer_attitude(force), 0.0])
