"""microSD logs that are not part of the repository: `make check-local`.

The folder named by GROUNDSTATION_LOCAL_DATA holds usd_card/log10, log15, log16 and
imrc/eckart00, 12, 22, 27, 34. An independent decoder, written record by record with
``struct``, says what every event and value must be.
"""

import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from groundstation.recording.microsd import read_microsd
from groundstation.recording.quality import inspect_recording

DATA = os.environ.get("GROUNDSTATION_LOCAL_DATA")
pytestmark = pytest.mark.skipif(
    DATA is None or not Path(DATA).is_dir(),
    reason="GROUNDSTATION_LOCAL_DATA names no folder with usd_card/ and imrc/",
)
USD_CARD = ("usd_card/log10", "usd_card/log15", "usd_card/log16")
IMRC = tuple(f"imrc/eckart{number}" for number in ("00", "12", "22", "27", "34"))
RECORDS = {
    "usd_card/log10": {"fixedFrequency": 50496},
    "usd_card/log15": {"fixedFrequency": 62774},
    "usd_card/log16": {"fixedFrequency": 47182},
    "imrc/eckart00": {"fixedFrequency": 4634, "estPose": 926},
    "imrc/eckart12": {"fixedFrequency": 3904, "estPose": 779},
    "imrc/eckart22": {"fixedFrequency": 3164, "estPose": 631},
    "imrc/eckart27": {"fixedFrequency": 2793, "estPose": 459},
    "imrc/eckart34": {"fixedFrequency": 2783, "estPose": 556},
}


def path_of(log):
    return Path(DATA) / log


def decoded_one_by_one(data):
    """event name -> list of (time in us, values), straight from the format's description."""
    version, count = struct.unpack_from("<HH", data, 1)
    assert (data[0], version) == (0xBC, 2)
    position, events, records = 5, {}, {}

    def text():
        nonlocal position
        start, position = position, data.index(b"\0", position) + 1
        return data[start : position - 1].decode()

    for _ in range(count):
        (number,) = struct.unpack_from("<H", data, position)
        position += 2
        name = text()
        (variables,) = struct.unpack_from("<H", data, position)
        position += 2
        names = [text() for _ in range(variables)]
        layout = struct.Struct("<HQ" + "".join(name[-2] for name in names))
        events[number] = (name, layout)
        records[name] = ([name[:-3] for name in names], [])
    while position < len(data) - 4:
        name, layout = events[struct.unpack_from("<H", data, position)[0]]
        _, time_us, *values = layout.unpack_from(data, position)
        records[name][1].append((time_us, values))
        position += layout.size
    assert zlib.crc32(data[:-4]) == struct.unpack_from("<I", data, len(data) - 4)[0]
    return records


@pytest.mark.parametrize("log", RECORDS)
def test_every_event_and_value_is_imported(log):
    recording = read_microsd(path_of(log))
    expected = decoded_one_by_one(path_of(log).read_bytes())
    assert recording.damage == []
    assert set(recording.tables) == set(expected)
    for event, (names, records) in expected.items():
        table = recording.tables[event]
        assert len(records) == RECORDS[log][event]
        assert list(table.columns) == names
        assert np.array_equal(np.rint(table.time_s * 1e6), [time for time, _ in records])
        for column, values in zip(names, zip(*(v for _, v in records), strict=True), strict=True):
            assert table.columns[column].tolist() == list(values), (event, column)
    assert len(recording.samples) == RECORDS[log]["fixedFrequency"]


@pytest.mark.parametrize("log", RECORDS)
def test_a_flipped_byte_is_reported_and_the_rest_is_kept(log, tmp_path):
    data = bytearray(path_of(log).read_bytes())
    rng = np.random.default_rng(len(data))
    first_record = data.index(b"\0", data.rindex(b"(")) + 1
    whole = RECORDS[log]["fixedFrequency"]
    for place in rng.integers(first_record, len(data), 8):
        damaged = bytearray(data)
        damaged[place] ^= 1 << rng.integers(8)
        (tmp_path / "log").write_bytes(damaged)
        recording = read_microsd(tmp_path / "log")
        assert any("checksum" in line for line in recording.damage)
        assert whole - 2 <= len(recording.samples) <= whole
        assert inspect_recording(recording)["verdict"].startswith("usable, with faults")


@pytest.mark.parametrize("log", IMRC)
def test_the_gyro_turns_the_attitude_in_our_frame(log):
    """Body rates from the quaternion agree with the gyro: unit, axes and signs are right."""
    samples = read_microsd(path_of(log)).samples
    time_s = samples.time_s
    turning = 0
    for axis, other in ((0, 1), (1, 0)):
        angle = samples.attitude[:, axis].astype(np.float64)
        level = np.abs(samples.attitude[:, other]) < 0.2
        rate = (angle[10:] - angle[:-10]) / (time_s[10:] - time_s[:-10])
        gyro, level = samples.gyro[5:-5, axis].astype(np.float64), level[5:-5]
        turning += np.count_nonzero(np.abs(gyro[level]) > 0.3)
        slope = float(gyro[level] @ rate[level] / (gyro[level] @ gyro[level]))
        assert 0.9 < slope < 1.1
    assert turning > 100


@pytest.mark.parametrize("log", IMRC)
def test_the_flights_are_plausible_in_si_units(log):
    recording = read_microsd(path_of(log))
    samples = recording.samples
    assert recording.metadata["microsd"]["gyro_unit"] == "deg/s"
    assert "attitude" in recording.metadata["microsd"]["gyro_unit_because"]
    assert 3.6 < np.nanmin(samples.battery_v) <= np.nanmax(samples.battery_v) < 4.0
    assert 0.25 < samples.duty.min() <= samples.duty.max() < 0.7
    assert 190 < samples.rotor_rev_s.min() <= samples.rotor_rev_s.max() < 350
    assert 9.5 < np.linalg.norm(samples.accelerometer, axis=1).mean() < 11.5
    report = inspect_recording(recording)
    assert 499 < report["rate_hz"] < 506
    assert report["gap_count"] == 1
    assert 0.023 < report["gaps"][0]["duration_s"] < 0.08


@pytest.mark.parametrize("log", USD_CARD)
def test_the_card_logs_are_plausible_in_si_units(log):
    recording = read_microsd(path_of(log))
    report = inspect_recording(recording)
    assert recording.metadata["microsd"]["gyro_unit"] == "deg/s"
    assert 1009 < report["rate_hz"] < 1011
    assert report["battery"] is None
    assert "roll" in report["missing"]
    assert 0.8 < report["ranges"]["duty_1"]["max"] < 1.0
