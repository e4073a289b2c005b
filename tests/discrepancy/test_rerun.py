"""The viewer gets measured and predicted channels of every held-out flight on one time axis."""

import numpy as np
import pytest

from groundstation.comparison.gap import CHANNELS
from groundstation.discrepancy.rerun_overlay import PAUSE_S, overlay_of
from groundstation.errors import BadInputError
from groundstation.viewer.overlay import write_overlay
from support.findings import findings, proof, report


@pytest.fixture(scope="module")
def overlay():
    found = findings()
    proven = proof(found)
    return overlay_of(proven, report(found, proven)), proven


def test_measured_less_predicted_is_the_error_that_was_judged(overlay):
    made, proven = overlay
    unit, values = made.channels["gyro_x"]
    assert unit == "deg/s"
    error = np.degrees(proven.before.errors[0].horizons[-1][:, 0])
    np.testing.assert_allclose(values[:, 0] - values[:, 1], error, atol=1e-9)
    measured = np.degrees(proven.before.errors[0].run.gyro[:, 0])
    np.testing.assert_allclose(values[:, 0], measured)


def test_flights_follow_each_other_with_a_pause(overlay):
    made, proven = overlay
    assert made.flights == ((0.0, proven.before.errors[0].run.name),)
    assert made.time_s[0] == 0.0
    assert np.diff(made.time_s).max() < PAUSE_S
    assert len(made.time_s) == len(proven.before.errors[0].run)


def test_the_gap_over_time_falls_to_noise(overlay):
    made, _ = overlay
    known = np.isfinite(made.gap).all(axis=1)
    before, after = np.sqrt(np.mean(made.gap[known] ** 2, axis=0))
    assert before > 1.5
    assert after == pytest.approx(1.0, abs=0.1)


def test_the_file_has_every_series_and_is_never_overwritten(overlay, tmp_path):
    from rerun.chunk import RrdReader

    made, _ = overlay
    path = tmp_path / "shown.rrd"
    write_overlay(made, path)
    rows = {}
    for chunk in RrdReader(path).stream():
        entity = chunk.entity_path.replace("\\", "")
        rows[entity] = rows.get(entity, 0) + chunk.to_record_batch().num_rows
    for channel in CHANNELS:
        assert rows[f"/channels/{channel}/measured"] >= len(made.time_s)
    assert rows["/gap/model"] > 10
    with pytest.raises(BadInputError, match="exists already"):
        write_overlay(made, path)
