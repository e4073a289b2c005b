"""What the page plots of a file, and how a stranger's file becomes a recording."""

import asyncio
import io
import json
import struct

import numpy as np
import pytest

from groundstation.errors import GroundStationError
from groundstation.page.app import UnknownColumnsError, add, add_example
from groundstation.page.reading import ROWS_MOST, series, write
from groundstation.recording.formats import open_recording
from support import RECORDINGS


def written(name):
    out = io.BytesIO()
    write(open_recording(RECORDINGS / name), out)
    content = out.getvalue()
    (length,) = struct.unpack_from("<I", content)
    return json.loads(content[4 : 4 + length]), content[4 + length :]


def test_samples_and_tables_are_told_from_the_first_sample_on_in_the_units_of_people():
    head, numbers = written("nanobench_trefoil.mcap")
    telemetry, *tables = head["tables"]
    assert telemetry["name"] == "telemetry"
    assert "attitude.roll" in telemetry["columns"]
    assert "rotors.M1" not in telemetry["columns"]  # it has none
    assert {"vicon", "setpoint", "controller"} == {one["name"] for one in tables}
    time_s = np.frombuffer(numbers[: 8 * telemetry["rows"]], "<f8")
    assert time_s[0] == 0.0
    assert time_s[-1] == pytest.approx(28.7, abs=0.1)
    assert (np.diff(time_s) > 0).all()
    samples = open_recording(RECORDINGS / "nanobench_trefoil.mcap").samples
    _, (first, *_) = series(open_recording(RECORDINGS / "nanobench_trefoil.mcap"))
    roll = first.columns["attitude.roll"]
    assert roll == pytest.approx(np.degrees(samples.attitude[:, 0]), abs=1e-3)


def test_of_a_long_recording_every_nth_sample_is_told():
    head, numbers = written("microsd_log16")
    for one in head["tables"]:
        assert one["every"] == 2
        assert one["rows"] <= ROWS_MOST
    assert len(numbers) % 8 == 0


async def pieces(content):
    yield content[:100]
    yield content[100:]


def test_a_strangers_file_becomes_a_recording_and_overwrites_none(tmp_path):
    content = (RECORDINGS / "thesis_excerpt.csv").read_bytes()
    names = [asyncio.run(add(tmp_path, "flight.csv", pieces(content))).file for _ in range(2)]
    assert names == ["flight.mcap", "flight_2.mcap"]
    assert len(open_recording(tmp_path / "flight_2.mcap").samples) == 25
    assert not (tmp_path / "opened").exists()


@pytest.mark.parametrize("name", ["../a.csv", ".a", "", "a\x07b"])
def test_a_name_leads_nowhere_else(tmp_path, name):
    with pytest.raises(GroundStationError, match="not a file's name"):
        asyncio.run(add(tmp_path, name, pieces(b"content")))


def test_what_is_no_recording_is_refused_in_words_and_leaves_nothing(tmp_path):
    for name in ("a.mcap", "a.csv"):
        with pytest.raises(GroundStationError, match=name):
            asyncio.run(add(tmp_path, name, pieces(b"no recording" * 20)))
    assert not list(tmp_path.iterdir())


UNKNOWN = "t_ms,turn,az\n" + "".join(f"{10 * n},{(-1) ** n * 90},9.8\n" for n in range(50))


def test_of_a_file_that_nobody_knows_the_columns_are_asked_and_nothing_is_kept(tmp_path):
    with pytest.raises(UnknownColumnsError) as asked:
        asyncio.run(add(tmp_path, "log.csv", pieces(UNKNOWN.encode())))
    form = asked.value.form
    assert [one["reference"] for one in form["columns"]] == ["t_ms", "turn", "az"]
    guessed = {one["key"]: one["column"] for one in form["channels"] if one["column"]}
    assert guessed == {"time": "t_ms", "accelerometer.z": "az"}
    assert not list(tmp_path.iterdir())


def test_the_answers_make_a_recording_and_a_map(tmp_path):
    chosen = [
        {"key": "time", "column": "t_ms", "unit": "ms"},
        {"key": "gyro.x", "column": "turn", "unit": "deg/s", "sign": -1},
    ]
    made = asyncio.run(add(tmp_path, "log.csv", pieces(UNKNOWN.encode()), json.dumps(chosen)))
    (tmp_path / "map.toml").write_text(made.map)
    (tmp_path / "log.csv").write_text(UNKNOWN)
    read = open_recording(tmp_path / "log.csv", column_map=tmp_path / "map.toml").samples
    shown = open_recording(tmp_path / made.file).samples
    assert np.degrees(shown.gyro[:2, 0]) == pytest.approx([-90.0, 90.0])
    assert np.array_equal(shown.gyro, read.gyro, equal_nan=True)
    assert not (tmp_path / "opened").exists()


@pytest.mark.parametrize("answers", [
    "no JSON", "[]", '[{"key": "time", "column": "t_ms", "unit": "ms"}]',
    '[{"key": "x]\\n[y", "column": 1, "unit": "ms"}]',
    '[{"key": "gyro.x", "column": "none", "unit": "deg/s"}]',
])  # fmt: skip
def test_answers_that_are_none_are_refused_in_words(answers, tmp_path):
    with pytest.raises(GroundStationError, match=r"log\.csv"):
        asyncio.run(add(tmp_path, "log.csv", pieces(UNKNOWN.encode()), answers))
    assert not list(tmp_path.iterdir())


def test_an_example_is_added_once(tmp_path):
    names = [asyncio.run(add_example(tmp_path, "thesis_excerpt.mcap")) for _ in range(2)]
    assert names == ["thesis_excerpt.mcap"] * 2
    with pytest.raises(GroundStationError, match="no such example"):
        asyncio.run(add_example(tmp_path, "../setup.py"))
