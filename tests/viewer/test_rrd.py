from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.rrd import ROWS_PER_CHUNK, write_rrd
from groundstation.recording.session import Recording, Table
from groundstation.telemetry.samples import empty_samples
from support.programs import run_program
from support.viewer import SCALARS, TEXT, column


def test_a_recording_is_shown_in_the_units_that_people_read(flight, tmp_path):
    path = tmp_path / "flight.rrd"
    write_rrd(flight, path)
    shown, said = column(path, SCALARS), column(path, TEXT)
    samples = flight.samples
    np.testing.assert_allclose(shown["/telemetry/rates"], np.degrees(samples.gyro), rtol=1e-6)
    np.testing.assert_allclose(shown["/telemetry/motors"], 100 * samples.duty, rtol=1e-6)
    assert len(said["/events"]) == len(flight.events)
    assert len(said["/commands"]) == len(flight.commands)
    rates = [[one["rate_hz"]] for one in flight.statistics if "rate_hz" in one]
    assert shown["/link/rate_hz"].tolist() == rates
    assert [entry.name for entry in tmp_path.iterdir()] == ["flight.rrd"]


def test_a_channel_that_comes_and_goes_is_in_the_file_where_it_is(wobble, tmp_path):
    samples = wobble(10_000)
    samples.attitude[ROWS_PER_CHUNK : 2 * ROWS_PER_CHUNK] = np.nan
    samples.battery_v[:] = np.nan
    write_rrd(Recording(Path("odd"), "csv", samples), tmp_path / "odd.rrd")
    shown = column(tmp_path / "odd.rrd", SCALARS)
    assert len(shown["/telemetry/attitude"]) == 10_000 - ROWS_PER_CHUNK
    assert "/telemetry/battery" not in shown


def test_the_numbers_of_tables_are_series(wobble, tmp_path):
    time_s = np.array([0.1, 0.2, 0.3])
    columns = {
        "pm.vbatMV": np.array([3700, 3701, 3702], np.uint16),
        "pos.x": np.array([0.1, np.nan, -3.5], np.float32),
        "kalman/inFlight": np.array([True, False, True]),
        "note": np.array(["a", "", "ü"]),
    }
    recording = Recording(
        Path("log01"), "microsd", replace(wobble(5), tick_s=1e-6),
        tables={"fixedFrequency": Table(time_s, columns), "event/odd name": Table(time_s[:0], {})},
    )  # fmt: skip
    write_rrd(recording, tmp_path / "log.rrd")
    shown = column(tmp_path / "log.rrd", SCALARS)
    tables = {name: values[:, 0] for name, values in shown.items() if name.startswith("/tables/")}
    assert tables.keys() == {
        f"/tables/fixedFrequency/{name}" for name in ("pm.vbatMV", "pos.x", "kalman/inFlight")
    }
    np.testing.assert_array_equal(tables["/tables/fixedFrequency/pm.vbatMV"], [3700, 3701, 3702])
    np.testing.assert_allclose(tables["/tables/fixedFrequency/pos.x"], [0.1, -3.5], rtol=1e-6)


def test_a_recording_without_samples_is_a_file_without_series(tmp_path):
    write_rrd(Recording(Path("empty"), "mcap", empty_samples(0)), tmp_path / "empty.rrd")
    assert not column(tmp_path / "empty.rrd", SCALARS)


def test_the_pilots_layout_is_in_the_file(flight, tmp_path):
    write_rrd(flight, tmp_path / "flight.rrd")
    reader = RrdReader(tmp_path / "flight.rrd")
    (blueprint,) = reader.blueprints()
    names = set()
    for chunk in reader.stream(store=blueprint):
        batch = chunk.to_record_batch()
        if "ViewBlueprint:display_name" in batch.schema.names:
            names.update(batch["ViewBlueprint:display_name"].flatten().to_pylist())
    assert {"Craft", "Attitude (deg)", "Rates (deg/s)", "Motors (% duty)", "Events"} <= names


def test_an_existing_file_is_never_overwritten(flight, tmp_path):
    path = tmp_path / "flight.rrd"
    path.write_text("precious")
    with pytest.raises(BadInputError, match="exists already"):
        write_rrd(flight, path)
    assert path.read_text() == "precious"


def test_a_missing_folder_is_named(flight, tmp_path):
    with pytest.raises(BadInputError, match="nowhere is not a folder"):
        write_rrd(flight, tmp_path / "nowhere" / "flight.rrd")


@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small file system needs root")
def test_a_full_disk_is_one_clear_line_and_leaves_nothing(wobble, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(disk)]
    if run_program(mount).returncode != 0:
        pytest.skip("this machine does not allow mounting a tmpfs")
    try:
        with pytest.raises(RecordingError, match="space on the disk") as caught:
            write_rrd(Recording(Path("big"), "csv", wobble(20_000)), disk / "big.rrd")
        assert "\n" not in str(caught.value)
        assert list(disk.iterdir()) == []
    finally:
        run_program(["umount", str(disk)], check=True)
