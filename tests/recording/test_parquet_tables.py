"""Parquet tables of other programs, by a column map like a CSV."""

import numpy as np
import pyarrow
import pytest
from pyarrow.parquet import write_table

from groundstation.errors import BadInputError, GroundStationError, RecordingError
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import write_mcap

ROWS = 400
TIME = 0.01 * np.arange(ROWS)


def benchmark(path, **changed):
    """The columns of the nano-drone benchmark."""
    wave = np.sin(7 * TIME)
    columns = {"t": TIME, "x": TIME, "y": 0 * TIME, "z": 1 + 0 * TIME}
    columns |= {"qx": 0 * TIME, "qy": 0 * TIME, "qz": np.sin(TIME / 2), "qw": np.cos(TIME / 2)}
    columns |= {"vx": wave, "vy": wave, "vz": wave, "wx": wave, "wy": 2 * wave, "wz": 3 * wave}
    columns |= {f"m{m}_rads": 1700.0 + m * wave for m in range(1, 5)}
    columns |= {"ax_body": wave, "ay_body": -wave, "az_body": 9.8 + wave}
    write_table(pyarrow.table({**columns, **changed}), path)
    return path


def test_the_benchmark_of_idsia_is_recognised_and_read(tmp_path):
    recording = open_recording(benchmark(tmp_path / "melon.parquet"))
    samples = recording.samples
    assert recording.kind == "parquet"
    assert recording.metadata["vehicle"] == {"profile": "brushless"}
    wave = np.sin(7 * TIME)
    assert samples.gyro == pytest.approx(np.column_stack([wave, 2 * wave, 3 * wave]), abs=1e-6)
    assert samples.accelerometer[:, 2] == pytest.approx(9.8 + wave, abs=1e-5)
    assert samples.rotor_rev_s[:, 3] == pytest.approx((1700 + 4 * wave) / 2 / np.pi, rel=1e-6)
    assert samples.attitude[:, 2] == pytest.approx(
        np.remainder(TIME + np.pi, 2 * np.pi) - np.pi, abs=1e-5
    )
    assert list(recording.tables) == ["position", "velocity"]
    write_mcap(recording, tmp_path / "melon.mcap")
    assert np.array_equal(open_recording(tmp_path / "melon.mcap").samples.gyro, samples.gyro)


def test_the_same_table_as_csv_reads_alike(tmp_path):
    table = benchmark(tmp_path / "a.parquet")
    from pyarrow.csv import write_csv
    from pyarrow.parquet import read_table

    write_csv(read_table(table), tmp_path / "a.csv")
    one, other = open_recording(table).samples, open_recording(tmp_path / "a.csv").samples
    assert np.array_equal(one.gyro, other.gyro)
    assert np.array_equal(one.ticks, other.ticks)


def test_a_map_of_ones_own_takes_dates_gaps_and_units_in_names(tmp_path):
    stamps = np.datetime64("2026-01-01") + (TIME * 1e9).astype("timedelta64[ns]")
    rate = pyarrow.array([None if k % 9 == 0 else float(k % 5) for k in range(ROWS)])
    table = pyarrow.table({"when": stamps, "rate [deg/s]": rate, "note": ["a"] * ROWS})
    write_table(table, tmp_path / "log.parquet")
    text = 'time = { column = "when", unit = "s" }\ngyro.x = { column = "%s", unit = "rad/s" }\n'
    (tmp_path / "map.toml").write_text(text % "rate")
    samples = open_recording(tmp_path / "log.parquet", column_map=tmp_path / "map.toml").samples
    assert np.isnan(samples.gyro[::9, 0]).all()
    assert np.degrees(samples.gyro[1:5, 0]) == pytest.approx([1, 2, 3, 4])
    assert np.diff(samples.time_s) == pytest.approx(0.01, abs=1e-6)
    (tmp_path / "text.toml").write_text(text % "note")
    with pytest.raises(BadInputError, match="'note' holds string, no numbers"):
        open_recording(tmp_path / "log.parquet", column_map=tmp_path / "text.toml")


def test_a_table_that_no_map_knows_says_what_it_has(tmp_path):
    write_table(pyarrow.table({"a": [1.0], "b": [2.0]}), tmp_path / "log.parquet")
    with pytest.raises(BadInputError, match=r"no column is a time \(a, b\).*--rate.*--map"):
        open_recording(tmp_path / "log.parquet")
    with pytest.raises(BadInputError, match="none of the columns that this map knows"):
        open_recording(tmp_path / "log.parquet", column_map="cfclient")
    with pytest.raises(BadInputError, match="px4 is a map of ulog"):
        open_recording(tmp_path / "log.parquet", column_map="px4")


@pytest.mark.parametrize("cut", [4, 100, -10])
def test_a_torn_table_is_one_line(cut, tmp_path):
    whole = benchmark(tmp_path / "a.parquet").read_bytes()
    (tmp_path / "torn.parquet").write_bytes(whole[:cut])
    with pytest.raises(GroundStationError) as caught:
        open_recording(tmp_path / "torn.parquet")
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, RecordingError)
