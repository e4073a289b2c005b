"""What cannot be in a channel, or does not agree with the others, is in the verdict."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.recording.csv_file import read_csv, write_table_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.quality import inspect_recording
from groundstation.recording.session import Recording

RECORDINGS = Path(__file__).parents[2] / "recordings"


@pytest.fixture(scope="module")
def flight():
    """From rest on the ground into the air, 31 s."""
    samples = open_recording(RECORDINGS / "stand_in_flight.mcap").samples
    return replace(samples, copies=np.ones(len(samples), np.uint8))


def verdict(samples):
    return inspect_recording(Recording(Path("made.csv"), "csv", samples))["verdict"]


def changed(samples, name, change):
    """A copy in which one of the channels went through ``change``."""
    values = getattr(samples, name).copy()
    given_back = change(values)
    return replace(samples, **{name: values if given_back is None else given_back})


def column(index, change):
    def on(values):
        values[:, index] = change(values[:, index])

    return on


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("battery_v", lambda v: 46 * v, "battery up to 1.* V, which cannot be"),
        ("battery_v", lambda v: 1e-3 * v, "battery up to 0.* V, which cannot be"),
        ("gyro", lambda v: 57.3 * v, "gyro_x.*deg/s, which cannot be, in .* of 15490 samples"),
        ("duty", lambda v: v - 0.5, "duty_1, duty_2, duty_3, duty_4 up to -0.5, which cannot be"),
        ("accelerometer", lambda v: 100 * v, "accelerometer_.* g, which cannot be"),
        ("attitude", lambda v: 57.3 * v, "roll, pitch.*deg, which cannot be"),
        ("gyro", lambda v: v / 57.3, "turns .* times as fast about x as gyro_x says"),
        ("gyro", column(1, np.negative), "pitch turns against gyro_y"),
        ("attitude", column(2, np.negative), "yaw turns against gyro_z"),
        ("gyro", lambda v: v[:, [1, 0, 2]], "roll turns with gyro_y, not gyro_x"),
        ("accelerometer", lambda v: 0.7 * v, "at rest the accelerometer reads 0.7 g"),
        ("accelerometer", column(2, np.negative), "accelerometer_z is -.* g in the mean: its sign"),
        ("duty", lambda v: 0.48 + 0.4 * v, "duty is 0.48 while the craft lies still"),
        ("duty", lambda v: v / 255, "duty never exceeds .* though the craft flies"),
        ("gyro", column(2, lambda v: 0 * v), "gyro_z is 0 throughout while the others change"),
        ("duty", column(3, lambda v: 0 * v + 0.5), "duty_4 is 0.5 throughout while the others"),
    ],
)
def test_what_cannot_be_is_a_fault(name, change, said, flight):
    wrong = changed(flight, name, change)
    found = verdict(wrong)
    assert found.startswith("usable, with faults: ")
    assert re.search(said, found), found
    assert verdict(flight).startswith("good: ")


def test_every_format_is_judged_alike(flight, tmp_path):
    wrong = changed(flight, "gyro", lambda v: v / 57.3)
    write_table_csv(Recording(Path("a"), "csv", wrong), tmp_path / "a.csv")
    assert "gyro_x says" in inspect_recording(read_csv(tmp_path / "a.csv"))["verdict"]


@settings(max_examples=15)
@given(st.integers(300, 3000), st.integers(4000, 9000), st.sampled_from(["gyro", "accelerometer"]))
def test_a_channel_that_stops_is_stuck_for_as_long(flight, rows, first, name):
    def stop(values):
        values[first : first + rows, 1] = values[first, 1]

    found = verdict(changed(flight, name, stop))
    assert f"{name}_y is stuck for {rows} samples from number {first + 1} on" in found


@settings(max_examples=15)
@given(st.floats(0.05, 0.95))
def test_missing_values_are_counted(flight, share):
    count = int(share * len(flight))

    def drop(values):
        values[np.linspace(0, len(flight) - 1, count).astype(int)] = np.nan

    report = inspect_recording(
        Recording(Path("made.csv"), "csv", changed(flight, "accelerometer", drop))
    )
    assert f"missing in {count} of 15490 samples" in report["verdict"]
    assert report["missing_values"]["accelerometer_x"] == count


def test_a_few_values_that_are_missing_at_the_start_are_no_fault(flight):
    """A log's sources begin one after the other."""

    def drop(values):
        values[:50] = np.nan

    assert verdict(changed(flight, "attitude", drop)).startswith("good: ")


@pytest.mark.parametrize("factor", [1000, 1 / 1000])
def test_a_time_in_another_unit_is_a_fault(flight, factor):
    ticks = np.rint((flight.ticks - flight.ticks[0]) * flight.tick_s * factor * 1e9)
    samples = replace(flight, ticks=ticks.astype(np.int64), tick_s=1e-9)
    assert "check the time's unit" in verdict(samples)


@pytest.mark.parametrize(
    "name", ["stand_in_flight.mcap", "nanobench_trefoil.mcap", "microsd_log16"]
)
def test_real_flights_have_no_such_fault(name):
    found = inspect_recording(open_recording(RECORDINGS / name))["verdict"]
    for word in ("cannot be", "turns", "stuck", "throughout", "lies still", "missing", "check"):
        assert word not in found, found


@pytest.mark.parametrize("rows", [2, 5, 10, 50])
def test_how_often_the_motors_are_renewed_is_measured(flight, rows):
    def hold(values):
        return values[np.arange(len(values)) // rows * rows]

    air = flight[3000:]
    report = inspect_recording(Recording(Path("a"), "csv", changed(air, "duty", hold)))
    assert report["renewed_hz"]["duty"] == pytest.approx(500 / rows, rel=0.1)
    assert report["renewed_hz"]["gyro"] == pytest.approx(500, rel=0.02)
    assert ("settings are renewed" in report["verdict"]) == (rows >= 2)
