"""End minus start of angles that a recording has only in some rows."""

import numpy as np
import pytest

from groundstation.attitude.fusion import fuse
from groundstation.telemetry.samples import empty_samples


def turning(rows=2000, dps=5.0):
    """Level at rest under gravity while the yaw turns evenly."""
    samples = empty_samples(rows, 1e-6)
    samples.ticks[:] = 2000 * np.arange(rows)
    samples.gyro[:] = [0.0, 0.0, np.radians(dps)]
    samples.accelerometer[:] = [0.0, 0.0, 9.81]
    samples.attitude[:] = 0.0
    samples.attitude[:, 2] = np.remainder(samples.time_s * np.radians(dps) + 3.0, 2 * np.pi)
    return samples


@pytest.mark.parametrize(
    "unknown", [slice(0, 0), slice(0, 20), slice(900, 1000), slice(1990, 2000)]
)
def test_rows_without_angles_take_nothing_from_what_the_others_say(unknown):
    samples = turning()
    samples.attitude[unknown] = np.nan
    known = np.flatnonzero(np.isfinite(samples.attitude[:, 2]))
    turned = 5.0 * (samples.time_s[known[-1]] - samples.time_s[known[0]])
    moved = fuse(samples).moved_deg()
    assert moved["reported"] == pytest.approx([0.0, 0.0, turned], abs=1e-3)
    assert moved["integrated"][2] == pytest.approx(5.0 * samples.time_s[-1], abs=0.02)


def test_without_any_angle_it_is_not_known():
    samples = turning(500)
    samples.attitude[:] = np.nan
    assert np.isnan(fuse(samples).moved_deg()["reported"]).all()
