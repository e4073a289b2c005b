from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.rrd import read_rrd, write_rrd
from groundstation.recording.session import Recording, Table
from groundstation.telemetry.samples import COLUMNS, empty_samples
from support.programs import run_program


def assert_same_samples(left, right):
    assert left.tick_s == right.tick_s
    for name in COLUMNS:
        a, b = getattr(left, name), getattr(right, name)
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b, err_msg=name)


def test_a_recording_comes_back_exactly(flight, tmp_path):
    path = tmp_path / "flight.rrd"
    write_rrd(flight, path)
    back = read_rrd(path)
    assert_same_samples(back.samples, flight.samples)
    assert (back.path, back.kind, back.link) == (path, "rrd", "usb")
    for part in ("events", "commands", "statistics", "metadata", "tables"):
        assert getattr(back, part) == getattr(flight, part), part
    assert [entry.name for entry in tmp_path.iterdir()] == ["flight.rrd"]


def test_channels_that_come_and_go_and_odd_values_come_back_exactly(wobble, tmp_path):
    samples = wobble(10_000)
    samples.attitude[3000:7000] = np.nan  # a whole chunk without attitude, and parts of two
    samples.rotor_rev_s[5000:5003] = [[1, 2, 3, 4], [np.nan, 2, 3, 4], [0.1, 0.2, 0.3, 0.4]]
    samples.gyro[17] = [np.inf, -np.inf, -0.0]
    samples.battery_v[:] = np.nan
    samples.debug[:] = np.iinfo(np.uint32).max
    samples.ticks[:] += 1 << 52
    write_rrd(Recording(Path("odd"), "csv", samples), tmp_path / "odd.rrd")
    assert_same_samples(read_rrd(tmp_path / "odd.rrd").samples, samples)


def test_tables_keep_every_value_and_type(wobble, tmp_path):
    time_s = np.array([0.1, 0.2, 0.30000000000000004])
    columns = {
        "pm.vbatMV": np.array([3700, 3701, 3702], np.uint16),
        "pos.x": np.array([0.1, np.nan, -3.5], np.float32),
        "kalman/inFlight": np.array([True, False, True]),
        "t64": np.array([1 << 62, -1, 0], np.int64),
        "note": np.array(["a", "", "ü"]),
    }
    recording = Recording(
        Path("log01"), "microsd", replace(wobble(5), tick_s=1e-6),
        tables={"fixedFrequency": Table(time_s, columns), "event/odd name": Table(time_s[:0], {})},
    )  # fmt: skip
    write_rrd(recording, tmp_path / "log.rrd")
    back = read_rrd(tmp_path / "log.rrd")
    assert back.samples.tick_s == 1e-6
    assert list(back.tables) == ["fixedFrequency", "event/odd name"]
    table = back.tables["fixedFrequency"]
    np.testing.assert_array_equal(table.time_s, time_s)
    assert list(table.columns) == list(columns)
    for name, values in columns.items():
        assert table.columns[name].dtype == values.dtype
        np.testing.assert_array_equal(table.columns[name], values)


def test_an_empty_recording_comes_back_empty(tmp_path):
    write_rrd(Recording(Path("empty"), "mcap", empty_samples(0)), tmp_path / "empty.rrd")
    assert len(read_rrd(tmp_path / "empty.rrd").samples) == 0


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


def test_an_rrd_of_another_program_is_refused_in_one_line(tmp_path):
    import rerun as rr

    stream = rr.RecordingStream("other")
    stream.save(tmp_path / "other.rrd")
    stream.log("telemetry/attitude", rr.Scalars([1.0, 2.0, 3.0]))
    stream.disconnect()
    with pytest.raises(RecordingError, match="not written by groundstation") as caught:
        read_rrd(tmp_path / "other.rrd")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"Timestamp,Battery\n1,2\n", b"RRF2"])
def test_a_file_that_is_no_rrd_is_refused_in_one_line(content, tmp_path):
    path = tmp_path / "odd.rrd"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"odd\.rrd cannot be read") as caught:
        read_rrd(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("where", [0.2, 0.4, 0.6, 0.8])
def test_a_flipped_byte_or_a_torn_file_is_never_read_as_good(flight, where, tmp_path):
    write_rrd(flight, tmp_path / "flight.rrd")
    data = bytearray((tmp_path / "flight.rrd").read_bytes())
    at = int(len(data) * where)
    (tmp_path / "torn.rrd").write_bytes(data[:at])
    with pytest.raises(RecordingError):
        read_rrd(tmp_path / "torn.rrd")
    data[at] ^= 0x10
    (tmp_path / "flipped.rrd").write_bytes(data)
    try:
        back = read_rrd(tmp_path / "flipped.rrd")
    except RecordingError:
        return
    assert_same_samples(back.samples, flight.samples)  # the byte was not in the data
    assert back.events == flight.events


def test_a_file_of_a_later_format_is_refused(flight, tmp_path, monkeypatch):
    monkeypatch.setattr("groundstation.recording.rrd.SCHEMA_VERSION", 2)
    write_rrd(flight, tmp_path / "flight.rrd")
    monkeypatch.undo()
    with pytest.raises(RecordingError, match="install a newer groundstation"):
        read_rrd(tmp_path / "flight.rrd")
