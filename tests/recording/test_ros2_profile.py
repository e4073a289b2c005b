"""Recordings for other programs: the MCAP profile ros2, and Parquet."""

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.formats import open_recording, writer_of
from groundstation.recording.mcap_scan import recover
from groundstation.recording.session import Recording
from groundstation.rerun_log.channels import rerun_program
from support.programs import run_program

FLIGHT = Path(__file__).parents[2] / "recordings" / "stand_in_flight.mcap"
ROWS = slice(4000, 6000)
MARK = {"time_ns": 0, "kind": "mark", "link": "operator", "text": 'new "Propeller" ä'}


@pytest.fixture(scope="module")
def flight():
    """Four seconds in the air with a mark among its events."""
    whole = open_recording(FLIGHT, raw=False)
    samples = whole.samples[ROWS]
    mark = {**MARK, "time_ns": int(samples.host_time_ns[10])}
    return Recording(
        path=whole.path, kind="mcap", samples=samples, events=[mark], metadata=whole.metadata
    )


@pytest.fixture(scope="module")
def written(flight, tmp_path_factory):
    """The flight at the full rate."""
    path = tmp_path_factory.mktemp("ros2") / "flight.mcap"
    writer_of(path, ros2_hz=500)(flight, path)
    return path


def by_rosbags(path):
    """Topic -> its messages, as rosbags gives them; all definitions from the file."""
    reader = pytest.importorskip("rosbags.highlevel").AnyReader
    found = {}
    with reader([path]) as bag:
        for connection, _, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    return found


def test_rosbags_reads_every_topic_and_every_row(written, flight):
    topics, samples = by_rosbags(written), flight.samples
    for topic in ("/row", "/imu", "/battery"):
        assert len(topics[topic]) == len(samples), topic
    rows = topics["/row"]
    for field, values in {
        "gyro_y_dps": np.degrees(samples.gyro[:, 1]),
        "accelerometer_z_g": samples.accelerometer[:, 2] / 9.80665,
        "pitch_deg": np.degrees(samples.attitude[:, 1]),
        "duty_4": samples.duty[:, 3],
        "battery_v": samples.battery_v,
        "device_s": samples.time_s,
        "copies": samples.copies,
    }.items():
        np.testing.assert_allclose([getattr(one, field) for one in rows], values, rtol=1e-6)
    assert np.isnan(rows[0].rotor_1_rev_s)
    stamp = rows[7].header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == samples.host_time_ns[7]
    (event,) = topics["/link/events"]
    assert json.loads(event.data)["text"] == MARK["text"]


def test_the_mcap_library_decodes_it_too(written, flight):
    with written.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        rows = [message for *_, message in reader.iter_decoded_messages(topics=["/row"])]
    assert {row.header.frame_id for row in rows} == {"base_link"}
    assert len(rows) == len(flight.samples)


def test_it_reads_back_here_as_what_it_was(written, flight):
    kept = open_recording(written)
    assert kept.damage == []
    assert np.array_equal(kept.samples.gyro, flight.samples.gyro)
    assert kept.events == flight.events


def test_a_lower_rate_thins_rows_and_keeps_the_samples(flight, tmp_path):
    writer_of(tmp_path / "thin.mcap", ros2_hz=100)(flight, tmp_path / "thin.mcap")
    topics = by_rosbags(tmp_path / "thin.mcap")
    assert len(topics["/row"]) == len(flight.samples) // 5
    assert len(open_recording(tmp_path / "thin.mcap").samples) == len(flight.samples)


def test_a_torn_bag_is_recovered_as_a_bag(flight, tmp_path):
    path = tmp_path / "bag.mcap"
    writer_of(path, ros2_hz=100)(flight, path)
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(path.read_bytes()[:-200])
    assert len(open_recording(torn).samples) == len(flight.samples)
    recovered = recover(torn).output
    assert len(by_rosbags(recovered)["/row"]) == len(flight.samples) // 5
    assert open_recording(recovered).events == flight.events


def test_a_parquet_table_has_every_row_with_its_units_and_events(flight, tmp_path):
    from pyarrow.parquet import read_table

    path = tmp_path / "flight.parquet"
    writer_of(path)(flight, path)
    table = read_table(path)
    assert np.array_equal(table["gyro_x"].to_numpy(), flight.samples.gyro[:, 0])
    assert np.array_equal(table["time_s"].to_numpy(), flight.samples.time_s)
    assert json.loads(table.schema.metadata[b"groundstation.events"]) == flight.events
    with pytest.raises(BadInputError, match="nothing is ever overwritten"):
        writer_of(path)(flight, path)
    with pytest.raises(RecordingError, match="not read back"):
        open_recording(path)


def test_only_mcap_takes_the_profile():
    with pytest.raises(BadInputError, match="--ros2 is for MCAP"):
        writer_of(Path("flight.csv"), ros2_hz=100)


def test_rerun_converts_every_row_without_us(written, flight, tmp_path):
    from rerun.chunk import RrdReader

    target = tmp_path / "flight.rrd"
    command = [str(rerun_program()), "mcap", "convert", str(written), "-o", str(target)]
    run_program(command, check=True)
    rows, fields = dict.fromkeys(("/row", "/imu", "/battery"), 0), set()
    for chunk in RrdReader(target).stream():
        table = chunk.to_record_batch()
        if chunk.entity_path in rows and "message_log_time" in table.schema.names:
            rows[chunk.entity_path] += table.num_rows
            for field in table.schema:
                if field.name.endswith("Row:message"):
                    fields |= {one.name for one in field.type.value_type}
    assert set(rows.values()) == {len(flight.samples)}
    assert {"gyro_x_dps", "accelerometer_z_g", "duty_4", "battery_v", "roll_deg"} <= fields
