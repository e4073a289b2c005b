import os
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from groundstation.errors import BadInputError, GroundStationError, RecordingError
from groundstation.recording.mcap_file import McapFile
from groundstation.recording.mcap_reader import read_mcap
from groundstation.recording.mcap_scan import recover
from support.packets import (
    COPIES,
    assert_same_packets,
    assert_same_samples,
    chunks,
    flight,
    records,
    write_flight,
)

ROWS = 120
METADATA = {"session": {"link": "usb"}, "vehicle": {"name": "crazyflie1"}}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    path = tmp_path_factory.mktemp("finished") / "flight.mcap"
    write_flight(path, ROWS, metadata=METADATA)
    return path.read_bytes()


def files(folder):
    return sorted(entry.name for entry in folder.iterdir())


def test_a_sound_file_is_left_alone(path, finished):
    path.write_bytes(finished)
    report = recover(path)
    assert report.sound
    assert report.output is None
    assert report.damage == []
    assert files(path.parent) == ["flight.mcap"]


def test_a_torn_file_becomes_a_sound_one_with_everything_before_the_tear(path, finished):
    torn = finished[: chunks(finished)[3][1] + 20]
    path.write_bytes(torn)
    report = recover(path)
    assert not report.sound
    assert report.output == path.with_name("flight.recovered.mcap")
    assert report.bytes_lost > 0
    assert report.chunks_skipped == 0
    assert path.read_bytes() == torn

    recovered = read_mcap(report.output, raw=True)
    assert_same_samples(recovered.samples, flight(0, 100)[1])
    assert_same_packets(recovered.raw, flight(0, 100)[0])
    assert [event["number"] for event in recovered.events] == [0, 25, 50, 75]
    assert recovered.damage == []
    assert recover(report.output).sound
    recovery = recovered.metadata.pop("recovery")
    assert recovered.metadata == METADATA
    assert recovery["source"] == "flight.mcap"
    assert recovery["messages"] == str(report.messages)
    assert recovery["bytes_lost"] == str(report.bytes_lost)
    assert recovery["damage_1"] == report.damage[0]


def test_a_bad_chunk_is_skipped_and_what_it_cost_is_told(path, finished):
    data = bytearray(finished)
    start, end = chunks(finished)[2]
    data[(start + end) // 2] ^= 1
    path.write_bytes(data)
    report = recover(path)
    assert (report.chunks_skipped, report.bytes_lost) == (1, end - start)
    assert report.seconds_lost == pytest.approx(0.05, abs=0.002)
    recovered = read_mcap(report.output, raw=True)
    assert_same_samples(recovered.samples, flight(0, ROWS)[1][np.r_[0:50, 75:ROWS]])
    assert len(recovered.raw) == COPIES * (ROWS - 25)


def test_every_message_keeps_its_topic_times_and_bytes(path, finished):
    path.write_bytes(finished[:-30])
    report = recover(path)
    source = path.with_name("source.mcap")
    source.write_bytes(finished)
    assert contents(report.output) == contents(source)


def contents(path):
    with path.open("rb") as file:
        return [
            (
                channel.topic,
                channel.message_encoding,
                channel.metadata,
                schema and (schema.name, schema.encoding, schema.data),
                message.log_time,
                message.publish_time,
                message.data,
            )
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages(
                log_time_order=False
            )
        ]


def test_channels_without_messages_stay_in_the_index(path, finished):
    path.write_bytes(finished[:-30])
    with recover(path).output.open("rb") as file:
        topics = {channel.topic for channel in make_reader(file).get_summary().channels.values()}
    assert {"/command", "/link/statistics"} <= topics


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_file_of_another_program_keeps_all_it_has(path, compression):
    with path.open("wb") as out:
        writer = Writer(out, compression=compression, chunk_size=500)
        writer.start(profile="ros2", library="another")
        schema = writer.register_schema("Thing", "jsonschema", b"{}")
        channels = [
            writer.register_channel("/a", "json", schema, {"unit": "m"}),
            writer.register_channel("/b", "raw", 0),
        ]
        writer.add_attachment(1, 2, "photo", "image/png", b"\x89PNG")
        writer.add_metadata("site", {"name": "field"})
        for k in range(100):
            writer.add_message(channels[k % 2], 100 + k, b"%d" % k, 50 + k)
        writer.finish()
    whole = path.read_bytes()
    expected = contents(path)
    path.write_bytes(whole[:-20])
    report = recover(path)
    assert contents(report.output) == expected
    assert report.messages == 100
    with report.output.open("rb") as file:
        reader = make_reader(file)
        (attachment,) = reader.iter_attachments()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert (attachment.name, attachment.data) == ("photo", b"\x89PNG")
    assert metadata["site"]["name"] == "field"
    with pytest.raises(RecordingError, match="another program"):
        read_mcap(report.output)


def test_an_existing_output_is_never_overwritten(path, finished):
    path.write_bytes(finished[:-30])
    first = recover(path).output
    kept = first.read_bytes()
    with pytest.raises(BadInputError, match="exists already"):
        recover(path)
    assert first.read_bytes() == kept


def test_the_input_cannot_be_the_output(path, finished):
    path.write_bytes(finished[:-30])
    with pytest.raises(BadInputError, match="exists already"):
        recover(path, path)
    assert path.read_bytes() == finished[:-30]


def test_a_link_in_the_place_of_the_output_is_not_followed(path, finished):
    path.write_bytes(finished[:-30])
    target = path.with_name("precious")
    os.symlink(target, path.with_name("flight.recovered.mcap"))
    with pytest.raises(BadInputError, match="exists already"):
        recover(path)
    assert not target.exists()


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (lambda whole: b"", "is empty"),
        (lambda whole: b"no recording at all" * 9, "not an MCAP file"),
        (lambda whole: whole[: chunks(whole)[0][1] - 1], "no message can be read"),
        (lambda whole: whole[:8] + bytes(9000), "no message can be read"),
    ],
)
def test_a_file_with_nothing_to_recover_is_one_clear_line_and_no_output(
    path, finished, content, line
):
    path.write_bytes(content(finished))
    with pytest.raises(RecordingError, match=line) as caught:
        recover(path)
    assert "\n" not in str(caught.value)
    assert files(path.parent) == ["flight.mcap"]


def test_a_missing_file_is_one_clear_line(path):
    with pytest.raises(BadInputError, match="no such file"):
        recover(path)


def test_a_full_disk_leaves_no_half_a_file(small_disk, path):
    write_flight(path, 20_000, chunk_rows=500, finish=False)
    with pytest.raises(RecordingError, match="No space left"):
        recover(path, small_disk / "out.mcap")
    assert files(small_disk) == []


def test_a_recovery_that_is_damaged_again_tells_of_both(path, finished):
    path.write_bytes(finished[:-30])
    first = recover(path).output
    first.write_bytes(first.read_bytes()[:-30])
    second = recover(first).output
    metadata = read_mcap(second).metadata
    assert metadata["recovery"]["source"] == "flight.mcap"
    assert metadata["recovery 2"]["source"] == "flight.recovered.mcap"


def test_memory_does_not_grow_with_the_file(path):
    """48 MB that do not compress, in chunks of 200 kB."""
    file = McapFile(path)
    channel = file.register_channel("/noise", "raw", 0, {})
    random = np.random.default_rng(1)
    for k in range(240):
        file.add_message(channel, k, random.bytes(200_000))
    file.flush()
    file.abandon()
    tracemalloc.start()
    try:
        report = recover(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert report.messages == 240
    assert peak < 24e6


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0, 1, exclude_max=True), flip=st.integers(1, 255))
def test_after_any_flipped_byte_the_recovery_is_sound_and_as_good_as_the_input(
    path, finished, place, flip
):
    damaged = bytearray(finished)
    damaged[int(place * len(finished))] ^= flip
    path.write_bytes(damaged)
    path.with_name("flight.recovered.mcap").unlink(missing_ok=True)
    report = recover(path)
    assert not report.sound
    before, after = read_mcap(path, raw=True), read_mcap(report.output, raw=True)
    assert_same_samples(after.samples, before.samples)
    assert_same_packets(after.raw, before.raw)
    assert after.events == before.events
    assert after.damage == []
    assert len(after.samples) >= ROWS - 25


def test_the_records_of_a_recovery_are_all_indexed(path, finished):
    """A viewer seeks by the index, so every chunk must be in it."""
    path.write_bytes(finished[: chunks(finished)[3][1]])
    output = recover(path).output
    with output.open("rb") as file:
        summary = make_reader(file).get_summary()
    offsets = [index.chunk_start_offset for index in summary.chunk_indexes]
    assert offsets == [start for start, _ in chunks(output.read_bytes())]
    assert summary.statistics.message_count == len(contents(output))
    places = [at for at, opcode, _ in records(output.read_bytes()) if opcode == Opcode.METADATA]
    assert [index.offset for index in summary.metadata_indexes] == places


def test_errors_are_the_projects_own(tmp_path):
    with pytest.raises(GroundStationError):
        recover(tmp_path)


@pytest.mark.parametrize("finish", [True, False])
def test_a_recording_whose_first_4_kb_are_zero_gives_the_rest(path, finish):
    """All that says what is in it stands there, and again only at the end of a finished one."""
    write_flight(path, 500, finish=finish)
    content = bytearray(path.read_bytes())
    content[:4096] = bytes(4096)
    path.write_bytes(content)
    report = recover(path)
    kept = read_mcap(report.output, raw=True)
    assert kept.damage == []
    assert len(kept.samples) >= 450
    assert_same_samples(kept.samples, flight(500 - len(kept.samples), len(kept.samples))[1])
    assert len(kept.raw) == COPIES * len(kept.samples)
    assert kept.events
