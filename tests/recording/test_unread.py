"""Files of formats that are known and not read say what they are and what to do."""

import pytest

from groundstation.errors import BadInputError, GroundStationError
from groundstation.recording.formats import open_recording

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
