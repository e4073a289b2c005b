"""What each inertial sensor says about attitude by itself (thesis 6.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from groundstation.telemetry.arrays import Array

REST_RATE = np.radians(3.0)
"""A craft whose rate varies by less than this (rad/s, standard deviation) lies still."""


def accelerometer_attitude(accelerometer: ArrayLike) -> Array:
    """Roll and pitch in rad from specific force (thesis eq. 6.1-6.2), (..., 3) to (..., 2).

    Any unit. True only where nothing but gravity acts: in the hand, not in flight. The roll uses
    the quadrant of a_z, so an upside-down craft is told from an upright one.
    """
    force = np.asarray(accelerometer, np.float64)
    x, y, z = force[..., 0], force[..., 1], force[..., 2]
    return np.stack([np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))], axis=-1)


def integrate_gyroscope(
    time_s: ArrayLike, gyro: ArrayLike, initial: ArrayLike = (0.0, 0.0, 0.0)
) -> Array:
    """Attitude (n, 3) in rad by integrating Euler rates (thesis eq. 6.3-6.6).

    time_s: (n,). gyro: (n, 3) rad/s; a rate counts from the sample before to its own, as the
    firmware takes it. initial: roll, pitch, yaw of the first row. Offsets of the gyro grow into
    the angles without bound: that is what the filters are for.
    """
    from groundstation.attitude.kernels import integrate

    time, rates = _columns(time_s, gyro)
    angles = np.empty((len(time), 3))
    integrate(time, rates, np.asarray(initial, np.float64), angles)
    return angles


def rest_bias(time_s: ArrayLike, gyro: ArrayLike, least_s: float = 0.5) -> Array | None:
    """Mean rate (3,) in rad/s while the craft lies still at the start, None where it never does.

    Looks at quarter-second pieces and stops at the first that moves; needs ``least_s``.
    """
    time, rates = _columns(time_s, gyro)
    end, step = 0, 0.25
    while True:
        last = int(np.searchsorted(time, time[0] + (end + 1) * step))
        first = int(np.searchsorted(time, time[0] + end * step))
        if last >= len(time) or last - first < 3:
            break
        if rates[first:last].std(axis=0).max() > REST_RATE:
            break
        # A slow steady turn is no rest: the mean must not wander from piece to piece.
        if np.abs(rates[first:last].mean(axis=0) - rates[:last].mean(axis=0)).max() > REST_RATE:
            break
        end += 1
    rows = int(np.searchsorted(time, time[0] + end * step))
    return rates[:rows].mean(axis=0) if end * step >= least_s else None


def _columns(time_s: ArrayLike, gyro: ArrayLike) -> tuple[Array, Array]:
    time = np.ascontiguousarray(time_s, np.float64)
    rates = np.ascontiguousarray(gyro, np.float64)
    if time.ndim != 1 or rates.shape != (len(time), 3) or len(time) < 2:
        raise ValueError(f"time {time.shape} and gyro {rates.shape}: need (n,) and (n, 3), n >= 2")
    return time, rates
