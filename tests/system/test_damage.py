"""Damaged, empty and foreign files: one clear line, exit status 1, and what is good is kept."""

import json

import numpy as np
import pytest
from mcap.writer import Writer

from groundstation.recording.csv_file import read_csv
from groundstation.recording.formats import open_recording
from support import RECORDINGS
from support.daemons import in_process, refused_run, require_failure
from support.packets import chunks, flight, write_flight

ROWS, CHUNK_ROWS = 500, 100


@pytest.fixture
def torn(tmp_path):
    """A recording whose last 100 samples are torn off inside their chunk."""
    path = tmp_path / "torn.mcap"
    write_flight(path, ROWS, chunk_rows=CHUNK_ROWS, finish=False)
    data = path.read_bytes()
    start, end = chunks(data)[-1]
    path.write_bytes(data[: (start + end) // 2])
    return path


@pytest.fixture
def flipped(tmp_path):
    """A finished recording with one bit wrong in the chunk of samples 200 to 299."""
    path = tmp_path / "flipped.mcap"
    write_flight(path, ROWS, chunk_rows=CHUNK_ROWS)
    data = bytearray(path.read_bytes())
    start, end = chunks(bytes(data))[2]
    data[(start + end) // 2] ^= 0x04
    path.write_bytes(data)
    return path


@pytest.fixture
def damaged(request, torn, flipped):
    """The path, and which samples of the flight are good."""
    if request.param == "torn":
        return torn, np.arange(400)
    return flipped, np.r_[0:200, 300:500]


def foreign_mcap(path):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Pose", "jsonschema", b"{}")
        channel = writer.register_channel("/other/pose", "json", schema)
        writer.add_message(channel, log_time=1, publish_time=1, data=b'{"x": 1}')
        writer.finish()


BAD_FILES = {
    "empty.mcap": (lambda path: path.write_bytes(b""), "is empty"),
    "text.mcap": (lambda path: path.write_bytes(b"\x00\x7fELF not a recording"), "neither MCAP"),
    "foreign.mcap": (foreign_mcap, "another program"),
    "headless.mcap": (lambda path: path.write_bytes(b"\x89MCAP0\r\n"), "headless.mcap"),
    "missing.mcap": (lambda path: None, "no such file"),
    "folder.mcap": (lambda path: path.mkdir(), "not a file"),
}


@pytest.fixture(params=sorted(BAD_FILES))
def bad_file(request, tmp_path):
    """A file without anything of ours, and what must be said of it."""
    make, says = BAD_FILES[request.param]
    path = tmp_path / request.param
    make(path)
    return path, says


def contents(folder):
    return {
        path: path.read_bytes() if path.is_file() else None for path in sorted(folder.iterdir())
    }


def test_a_file_that_is_no_recording_is_not_inspected_converted_recovered_or_replayed(
    bad_file, tmp_path, tmp_path_factory
):
    path, says = bad_file
    before = contents(tmp_path)
    commands = [["convert", path, tmp_path / "out.csv"]]
    if not path.is_dir():  # whose recordings are listed
        commands.append(["inspect", path])
    for command in commands:
        line = require_failure(in_process(*command))
        assert str(path) in line
        assert says in line
    result = in_process("recover", path)
    if path.name == "foreign.mcap":  # a sound file: of another program, but that is no damage
        assert result.returncode == 0
        assert "sound" in result.stdout
    else:
        assert str(path) in require_failure(result)
    folder = tmp_path_factory.mktemp("daemon")
    assert says in refused_run(folder, "--link", f"replay:{path}")
    assert list(folder.iterdir()) == []
    assert contents(tmp_path) == before


@pytest.mark.parametrize("damaged", ["torn", "flipped"], indirect=True)
def test_inspect_reports_what_is_good_and_what_is_not(damaged):
    path, good = damaged
    result = in_process("inspect", path, "--json")
    line = require_failure(result)
    assert str(path) in line
    assert "groundstation recover" in line
    report = json.loads(result.stdout)
    assert report["samples"] == len(good)
    assert report["damage"]
    assert report["verdict"].startswith("usable, with faults")


@pytest.mark.parametrize("damaged", ["torn", "flipped"], indirect=True)
@pytest.mark.parametrize("kind", ["csv", "mcap"])
def test_convert_keeps_what_is_good_and_exits_with_an_error(damaged, tmp_path, kind):
    path, good = damaged
    target = tmp_path / f"good.{kind}"
    require_failure(in_process("convert", path, target))
    _, samples = flight(0, ROWS)
    converted = read_csv(target) if kind == "csv" else open_recording(target)
    np.testing.assert_array_equal(converted.samples.ticks, samples.ticks[good])
    np.testing.assert_array_equal(converted.samples.gyro, samples.gyro[good])
    assert converted.damage == []


@pytest.mark.parametrize("damaged", ["torn", "flipped"], indirect=True)
def test_recover_makes_a_sound_copy_and_leaves_its_input_alone(damaged):
    path, good = damaged
    before = path.read_bytes()
    result = in_process("recover", path)
    assert result.returncode == 0, result.stderr
    recovered = path.with_name(f"{path.stem}.recovered.mcap")
    assert str(recovered) in result.stdout
    assert path.read_bytes() == before
    _, samples = flight(0, ROWS)
    recording = open_recording(recovered)
    assert recording.damage == []
    np.testing.assert_array_equal(recording.samples.ticks, samples.ticks[good])
    again = recovered.read_bytes()
    assert "exists already" in require_failure(in_process("recover", path))
    assert recovered.read_bytes() == again


@pytest.mark.parametrize("target", ["torn.mcap", "./torn.mcap", "link.mcap", "hard.mcap"])
def test_recover_never_writes_over_its_input(torn, target):
    before = torn.read_bytes()
    (torn.parent / "link.mcap").symlink_to(torn)
    (torn.parent / "hard.mcap").hardlink_to(torn)
    line = require_failure(in_process("recover", torn, "-o", target, cwd=torn.parent))
    assert "exists already" in line
    assert torn.read_bytes() == before


def test_recover_says_in_json_what_it_did(torn, tmp_path):
    result = in_process("recover", torn, "-o", tmp_path / "new.mcap", "--json")
    assert result.returncode == 0
    report = json.loads(result.stdout)
    assert report["sound"] is False
    assert report["output"] == str(tmp_path / "new.mcap")
    assert report["messages"] > 0
    assert report["damage"]


def test_a_sound_recording_needs_no_recovery(tmp_path):
    path = tmp_path / "sound.mcap"
    write_flight(path, 50)
    result = in_process("recover", path)
    assert result.returncode == 0
    assert "nothing to do" in result.stdout
    assert list(tmp_path.iterdir()) == [path]


def test_a_flipped_byte_in_a_microsd_log_is_reported_and_the_rest_kept(tmp_path):
    data = bytearray((RECORDINGS / "microsd_log16").read_bytes())
    data[len(data) // 2] ^= 0x40
    path = tmp_path / "log16"
    path.write_bytes(data)
    result = in_process("inspect", path, "--json")
    line = require_failure(result)
    assert str(path) in line
    whole = len(open_recording(RECORDINGS / "microsd_log16").samples)
    assert whole - 20 < json.loads(result.stdout)["samples"] <= whole


def test_a_damaged_line_of_a_table_names_its_line(tmp_path):
    path = tmp_path / "bad.csv"
    lines = (RECORDINGS / "thesis_excerpt.csv").read_text().splitlines()
    lines[7] = lines[7].replace(",", ",x", 1)
    path.write_text("\n".join(lines) + "\n")
    line = require_failure(in_process("convert", path, tmp_path / "out.mcap"))
    assert "line 8" in line
    assert not (tmp_path / "out.mcap").exists()
