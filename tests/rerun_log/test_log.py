from __future__ import annotations

import math

import numpy as np
import pytest

from groundstation.rerun_log.channels import CRAFT, GROUPS
from groundstation.rerun_log.log import quaternions, sample_columns
from groundstation.telemetry.samples import empty_samples

BY_COLUMN = {group.column: group for group in GROUPS}


def shown(samples, column):
    entity = BY_COLUMN[column].entity
    (values,) = dict(sample_columns(samples))[entity]
    flat = values.as_arrow_array().flatten().to_numpy()
    return flat.reshape(len(samples), -1)


@pytest.mark.parametrize(
    ("column", "si", "people_read"),
    [
        ("attitude", math.pi / 6, 30.0),
        ("gyro", math.pi, 180.0),
        ("accelerometer", 9.80665, 1.0),
        ("duty", 0.25, 25.0),
        ("battery_v", 3.7, 3.7),
        ("rotor_rev_s", 300.0, 18000.0),
    ],
)
def test_people_read_their_own_units(column, si, people_read):
    samples = empty_samples(2)
    getattr(samples, column)[:] = si
    np.testing.assert_allclose(shown(samples, column), people_read, rtol=1e-6)


def test_positive_pitch_puts_the_drawn_nose_down():
    x, y, z, w = quaternions(np.array([[0, 0.3, 0]], np.float32))[0]
    nose_height = 2 * (x * z - y * w)
    assert nose_height == pytest.approx(-math.sin(0.3), abs=1e-6)


def test_a_channel_that_the_source_does_not_have_is_not_shown():
    samples = empty_samples(3)
    samples.gyro[:] = 1.0
    assert {entity for entity, _ in sample_columns(samples)} == {BY_COLUMN["gyro"].entity}


def test_a_craft_without_attitude_is_not_moved(wobble):
    samples = wobble(3)
    assert CRAFT in dict(sample_columns(samples))
    samples.attitude[1, 2] = np.nan
    assert CRAFT not in dict(sample_columns(samples))


def test_every_series_has_a_name_and_a_color():
    for group in GROUPS:
        width = getattr(empty_samples(1), group.column).reshape(1, -1).shape[1]
        assert len(group.names) == len(group.colors) == width
