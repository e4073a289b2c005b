"""One recording through every way to an attitude, beside the reported one (thesis 6.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.attitude.filters import KalmanNoise, complementary, kalman
from groundstation.attitude.sensors import (
    accelerometer_attitude,
    integrate_gyroscope,
    rest_bias,
)
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import SampleBatch

LEAST_ROWS = 100
END_SHARE, END_ROWS = 20, 500
"""Start and end are those of lines through a twentieth of the recording, a second at most."""


@dataclass(frozen=True, slots=True)
class Fused:
    """Angles by method, (n, 3) roll, pitch, yaw in rad; ``accelerometer`` has no yaw (NaN).

    time_s: (n,). rest_bias: (3,) rad/s, or None where the recording does not begin at rest.
    """

    time_s: Array
    angles: dict[str, Array]
    rest_bias: Array | None
    weight: float
    noise: KalmanNoise

    def moved_deg(self) -> dict[str, list[float]]:
        """End minus start, by method, of the rows that have angles."""
        return {name: _moved_deg(angles) for name, angles in self.angles.items()}


def _moved_deg(angles: Array) -> list[float]:
    """The last less the first of each axis of (n, 3), of the rows that have it, both by straight
    lines through what is around them."""
    moved = []
    for axis in angles.T:
        known = axis[np.isfinite(axis)]
        ends = max(1, min(len(known) // END_SHARE, END_ROWS))
        first, last = _at_start(known[:ends]), _at_start(known[::-1][:ends])
        moved.append(last - first)
    return [float(one) for one in np.degrees(moved)]


def _at_start(values: Array) -> float:
    """The line through values (n,) at the first of them; NaN without any."""
    if len(values) < 3:
        return float(values[0]) if len(values) else np.nan
    _, start = np.polyfit(np.arange(len(values)), values, 1)
    return float(start)


def _unwrapped(attitude: Array) -> Array:
    """Angles (n, 3) without jumps of a turn, across rows that have none as well."""
    out = attitude.copy()
    known = np.isfinite(attitude).all(axis=1)
    out[known] = np.unwrap(attitude[known], axis=0)
    return out


def fuse(samples: SampleBatch, weight: float = 0.998, noise: KalmanNoise | None = None) -> Fused:
    """Integration, accelerometer, complementary filter (W), Kalman filter (Q, R).

    Raises BadInputError for too few rows with gyro and accelerometer, and a weight outside 0..1.
    """
    if not 0.0 <= weight <= 1.0:
        raise BadInputError(f"weight {weight:g}: must be 0..1")
    inertial = np.hstack([samples.gyro, samples.accelerometer])
    samples = samples[np.flatnonzero(np.isfinite(inertial).all(axis=1))]
    if len(samples) < LEAST_ROWS:
        raise BadInputError("too few rows with gyro and accelerometer")
    time, force = samples.time_s, samples.accelerometer
    bias = rest_bias(time, samples.gyro)
    gyro = samples.gyro - (np.zeros(3) if bias is None else bias)
    chosen = noise or KalmanNoise()
    tilt = accelerometer_attitude(force)
    angles = {
        "integrated": integrate_gyroscope(time, samples.gyro),
        "accelerometer": np.column_stack([tilt, np.full(len(tilt), np.nan)]),
        "complementary": complementary(time, samples.gyro, force, weight),
        "kalman": kalman(time, gyro, force, chosen).attitude,
        "reported": _unwrapped(samples.attitude.astype(np.float64)),
    }
    return Fused(time, angles, bias, weight, chosen)
