"""Samples as people meet them: a line in a notebook, a table for other programs."""

import numpy as np

from groundstation.telemetry.samples import COLUMNS, empty_samples
from support.packets import flight


def test_a_batch_says_in_a_line_how_much_there_is_of_what():
    samples = flight(0, 50)[1]
    text = repr(samples)
    assert text.startswith("SampleBatch(50 rows, 0.10 s at 500 Hz: battery_v, duty, gyro")
    assert "rotor_rev_s" not in text
    assert repr(empty_samples(0)) == "SampleBatch(empty)"
    assert "1 rows" in repr(samples[:1])


def test_every_number_of_a_batch_is_in_the_arrow_table():
    samples = flight(0, 50)[1]
    table = samples.to_arrow()
    widths = [getattr(samples, name).reshape(len(samples), -1).shape[1] for name in COLUMNS]
    assert len(table.column_names) == 1 + sum(widths)
    np.testing.assert_array_equal(table["gyro_y"].to_numpy(), samples.gyro[:, 1])
    np.testing.assert_array_equal(table["attitude_yaw"].to_numpy(), samples.attitude[:, 2])
    np.testing.assert_array_equal(table["duty_4"].to_numpy(), samples.duty[:, 3])
    np.testing.assert_array_equal(table["time_s"].to_numpy(), samples.time_s)
