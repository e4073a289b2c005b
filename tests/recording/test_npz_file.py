"""The stand-in's own files of packets, written by the stand-in itself."""

import io
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from groundstation.errors import RecordingError
from groundstation.recording.formats import open_recording
from support.packets import assert_same_samples
from support.programs import run_program


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("npz")
    for name in ("flight.npz", "flight.csv"):
        told = run_program(
            [*(sys.executable, "-m", "firmware_sim", "--craft", "crazyflie21", "--for", "8"),
             *("--seed", "3", "--fast", "-o", folder / name)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        assert told.returncode == 0, told.stdout
    return folder / "flight.npz"


def test_it_opens_with_the_samples_of_the_same_flight_as_csv_and_names_the_craft(flight):
    recording = open_recording(flight, raw=True)
    as_csv = open_recording(flight.with_suffix(".csv"))
    assert recording.kind == "npz"
    assert recording.metadata["vehicle"] == {"profile": "crazyflie21"}
    assert len(recording.raw.packets) > 3 * len(recording.samples) > 3000
    np.testing.assert_array_equal(recording.samples.ticks, as_csv.samples.ticks)
    np.testing.assert_array_equal(recording.samples.gyro, as_csv.samples.gyro)


def test_a_flipped_byte_is_told_or_changes_nothing(flight, tmp_path):
    content, sound = flight.read_bytes(), open_recording(flight).samples
    path, told = tmp_path / "damaged.npz", []
    for place in np.random.default_rng(1).integers(4, len(content), 60):
        damaged = bytearray(content)
        damaged[place] ^= 0x41
        path.write_bytes(damaged)
        try:
            assert_same_samples(open_recording(path).samples, sound)
        except RecordingError as error:
            told.append(str(error))
    assert len(told) > 50
    assert all(line.startswith(str(path)) for line in told)


def zipped(path, **arrays):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array), allow_pickle=True)
            file.writestr(f"{name}.npy", content.getvalue())
    return path


NOISE = np.random.default_rng(0).integers(0, 256, (100, 32), np.uint8)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"theta": [1.0]}, "a zip file without packets and arrival_s"),
        ({"packets": NOISE}, "without arrival_s"),
        ({"packets": NOISE[:, :31], "arrival_s": np.zeros(100)}, "rows of 32"),
        ({"packets": NOISE, "arrival_s": np.zeros(99)}, "one float64 for each packet"),
        ({"packets": NOISE, "arrival_s": np.full(100, np.nan)}, "times that no recording can"),
        ({"packets": NOISE, "arrival_s": np.full(100, 1e300)}, "times that no recording can"),
        ({"packets": NOISE[:0], "arrival_s": np.zeros(0)}, "none of its 0 packets"),
        ({"packets": np.zeros((10**6, 32), np.uint8), "arrival_s": np.zeros(1)}, "unpacks to"),
        ({"packets": np.array([print]), "arrival_s": np.zeros(1)}, "damaged, or no numpy file"),
    ],
)
def test_what_is_none_is_told_in_a_line(tmp_path, arrays, words):
    with pytest.raises(RecordingError, match=words) as told:
        open_recording(zipped(tmp_path / "other.npz", **arrays))
    assert "\n" not in str(told.value)


def test_a_header_that_promises_more_than_there_is_takes_no_memory(tmp_path):
    """10^13 rows in a member of a kilobyte."""
    header = io.BytesIO()
    said = {"descr": "|u1", "fortran_order": False, "shape": (10**13, 32)}
    np.lib.format.write_array_header_1_0(header, said)
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("packets.npy", header.getvalue() + bytes(1000))
    with pytest.raises(RecordingError, match="damaged, or no numpy file"):
        open_recording(path)
