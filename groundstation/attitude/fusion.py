"""One recording through every way to an attitude, beside the reported one (thesis 6.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.attitude.filters import KalmanNoise, complementary, kalman, likeliest_noise
from groundstation.attitude.sensors import (
    accelerometer_attitude,
    integrate_gyroscope,
    rest_bias,
)
from groundstation.errors import BadInputError
from groundstation.telemetry.samples import SampleBatch

Array = NDArray[np.float64]

LEAST_ROWS = 100
END_SHARE, END_ROWS = 20, 500
"""Start and end are means over a twentieth of the recording, a second at most."""


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
        """End minus start, by method."""
        ends = max(1, min(len(self.time_s) // END_SHARE, END_ROWS))
        return {
            name: np.degrees(v[-ends:].mean(axis=0) - v[:ends].mean(axis=0)).tolist()
            for name, v in self.angles.items()
        }


def fuse(
    samples: SampleBatch, weight: float = 0.998, noise: KalmanNoise | None = None, *, tune: bool
) -> Fused:
    """Integration, accelerometer, complementary filter (W), Kalman filter (Q, R).

    tune: Q and R by likelihood, from ``noise`` on. Raises BadInputError for too few rows with gyro
    and accelerometer, and a weight outside 0..1.
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
    if tune:
        chosen = likeliest_noise(time, gyro, force, chosen)
    tilt = accelerometer_attitude(force)
    angles = {
        "integrated": integrate_gyroscope(time, samples.gyro),
        "accelerometer": np.column_stack([tilt, np.full(len(tilt), np.nan)]),
        "complementary": complementary(time, samples.gyro, force, weight),
        "kalman": kalman(time, gyro, force, chosen).attitude,
        "reported": np.unwrap(samples.attitude.astype(np.float64), axis=0),
    }
    return Fused(time, angles, bias, weight, chosen)
