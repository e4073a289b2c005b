from pathlib import Path

import msgspec
import pytest

from groundstation import recording as package
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError, GroundStationError, RecordingError
from groundstation.recording import formats
from groundstation.recording.csv_file import write_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.session import Recording, require_craft_of
from support import RECORDINGS
from support.packets import assert_same_samples, flight, write_flight


@pytest.fixture
def path(tmp_path):
    return tmp_path / "flight.whatever"


def test_an_mcap_file_is_known_by_its_content(path):
    write_flight(path, 50)
    recording = open_recording(path, raw=True)
    assert recording.kind == "mcap"
    assert len(recording.raw) == 200


def test_an_mcap_file_with_a_damaged_first_byte_is_still_one(path):
    write_flight(path, 50)
    data = bytearray(path.read_bytes())
    data[0] ^= 0xFF
    path.write_bytes(data)
    recording = open_recording(path)
    assert_same_samples(recording.samples, flight(0, 50)[1])
    assert "opening mark" in recording.damage[0]


def test_a_csv_file_is_known_by_its_content(path):
    write_csv(Recording(path, "made", flight(0, 50)[1]), path)
    recording = open_recording(path)
    assert recording.kind == "csv"
    assert (recording.samples.ticks == flight(0, 50)[1].ticks).all()


def test_a_microsd_log_is_known_by_its_content(path):
    header = b"\xbc\x02\x00\x01\x00\xff\xfffixedFrequency\x00\x01\x00gyro.x(f)\x00"
    path.write_bytes(header + b"\0" * 4)
    assert open_recording(path).kind == "microsd"


def test_a_column_map_is_for_files_of_other_programs(path, tmp_path):
    path.write_bytes(b"PK\x03\x04")
    with pytest.raises(BadInputError, match="takes no column map"):
        open_recording(path, column_map=tmp_path / "map.toml")


@pytest.mark.parametrize(
    ("content", "line"), [(b"", "is empty"), (b"\x7fELF\2\1\1\0" * 9, "neither MCAP")]
)
def test_anything_else_is_one_clear_line(path, content, line):
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=line) as caught:
        open_recording(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_one_clear_line():
    with pytest.raises(BadInputError, match="no such file"):
        open_recording(Path("nowhere.mcap"))


def test_a_folder_is_one_clear_line(tmp_path):
    with pytest.raises(BadInputError, match="not a file"):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    ("name", "seconds"), [("nanobench_figure8.mcap", 26.8), ("nanobench_trefoil.mcap", 28.7)]
)
def test_a_real_flight_of_todays_craft_is_in_the_repository(name, seconds):
    recording = open_recording(RECORDINGS / name)
    samples = recording.samples
    assert recording.damage == []
    assert recording.metadata["vehicle"] == {"profile": "crazyflie21"}
    assert samples.time_s[-1] - samples.time_s[0] == pytest.approx(seconds, abs=0.1)
    flying = samples.duty.min(axis=1) > 0.5
    assert samples.accelerometer[flying, 2].mean() == pytest.approx(9.8, abs=0.2)
    height = recording.tables["vicon"].columns["pz"]
    assert 0.8 < height[flying].mean() < 1.2


TAPE = """
import numpy as np

from groundstation.errors import RecordingError
from groundstation.recording.session import Recording, require_craft_of
from groundstation.telemetry.samples import RawBatch
from groundstation.telemetry.decoder import decode_all


def read_tape(path):
    content = np.frombuffer(path.read_bytes()[4:], np.uint8)
    if not content.size or content.size % 40:
        raise RecordingError(f"{path}: cut off; copy it again")
    rows = content.reshape(-1, 40)
    raw = RawBatch(rows[:, :32], rows[:, 32:].copy().view(np.int64)[:, 0])
    return Recording(path, "tape", decode_all(raw)[0], raw)


def write_tape(recording, path):
    raw = recording.raw
    times = raw.host_time_ns.astype(np.int64)[:, None].view(np.uint8)
    path.write_bytes(b"TAPE" + np.hstack([raw.packets, times]).tobytes())
"""


def test_a_format_is_added_by_one_row_and_one_file(tmp_path, monkeypatch):
    (tmp_path / "tape_file.py").write_text(TAPE)
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    row = formats.Format(
        lambda head: head.startswith(b"TAPE"),
        "tape_file.read_tape",
        ".tape",
        "tape_file.write_tape",
    )
    monkeypatch.setattr(formats, "FORMATS", (row, *formats.FORMATS))
    write_flight(tmp_path / "flight.mcap", 50)
    known = open_recording(tmp_path / "flight.mcap", raw=True)
    tape = tmp_path / "flight.tape"
    formats.writer_of(tape)(known, tape)
    again = open_recording(tape)
    assert again.kind == "tape"
    assert_same_samples(again.samples, known.samples)
    tape.write_bytes(tape.read_bytes()[:-1])
    with pytest.raises(RecordingError, match="copy it again"):
        open_recording(tape)


# Which craft a log that names none may be of.


@pytest.mark.parametrize("base", ["crazyflie1", "crazyflie21", "brushless"])
def test_a_profile_of_ones_own_is_the_word_on_what_flew(base):
    mine = msgspec.structs.replace(load_vehicle(base), name="mine")
    require_craft_of(open_recording(RECORDINGS / "microsd_log16"), vehicle_model(mine))


def test_a_built_in_profile_can_be_contradicted():
    log = open_recording(RECORDINGS / "microsd_log16")
    require_craft_of(log, vehicle_model(load_vehicle("crazyflie21")))
    with pytest.raises(BadInputError, match=r"of a Crazyflie 2\.x .*, not of 'crazyflie1'"):
        require_craft_of(log, vehicle_model(load_vehicle("crazyflie1")))


# Files of formats that are known and not read say what they are and what to do.


REST = bytes(range(256)) * 4
FILES = {
    "a Git LFS pointer, not the file itself (1048576 bytes): git lfs pull": (
        b"version https://git-lfs.github.com/spec/v1\noid sha256:ab\nsize 1048576\n"
    ),
    "a raw Betaflight blackbox log, which is not read; blackbox_decode": (
        b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n" + REST
    ),
    "an ArduPilot dataflash log, which is not read; mavlogdump.py": b"\xa3\x95\x80\x80\x59FMT"
    + REST,
    "a text dump of an ArduPilot log": b"FMT, 128, 89, FMT, BBnNZ, Type,Length\n",
    "a MAVLink telemetry log": (1_600_000_000_000_000).to_bytes(8, "big") + b"\xfd\x1c\x00" + REST,
    "a rerun recording, which is not read; give the recording that it was made of": b"RRF2" + REST,
    "HDF5": b"\x89HDF\r\n\x1a\n" + REST,
    "a MATLAB file": b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + REST,
    "a compressed file, which is not read; unpack it": b"\x1f\x8b\x08\x00" + REST,
    "a spreadsheet": b"PK\x03\x04\x14\x00\x06\x00[Content_Types].xml" + REST,
    "a web page and no recording": b"<!DOCTYPE html>\n<html><p>404</p></html>\n",
    "motion capture by OptiTrack": b"Format Version,1.23,Take Name,Take 1\n\n,,,Rigid Body\n",
    "a Python pickle": b"\x80\x04\x95" + REST,
    "a motion capture C3D file": b"\x02P\x10\x00" + REST,
}


@pytest.mark.parametrize("said", FILES)
@pytest.mark.parametrize("suffix", [".csv", ".mcap", ""])
def test_a_known_format_is_named_with_the_way_to_convert_it(said, suffix, tmp_path):
    path = tmp_path / f"log{suffix}"
    path.write_bytes(FILES[said])
    with pytest.raises(BadInputError) as caught:
        open_recording(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_begins_with_letters_of_another_format_is_read_as_text(tmp_path):
    (tmp_path / "log.csv").write_text("Hall,Timestamp,gyro.x\n1,0,1\n1,2,1\n")
    assert len(open_recording(tmp_path / "log.csv").samples) == 2


def test_nothing_known_is_said_to_be_none_of_what_is_read(tmp_path):
    (tmp_path / "log").write_bytes(b"\x01\x02\x03" + REST)
    with pytest.raises(GroundStationError, match=r"neither MCAP, CSV, .* Parquet"):
        open_recording(tmp_path / "log")
