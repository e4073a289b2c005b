from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.mcap_file import RecordingFile, write_mcap
from groundstation.recording.mcap_reader import read_mcap
from groundstation.recording.mcap_schemas import SAMPLE_FIELDS, SAMPLES_DEFINITION, Definition
from groundstation.recording.session import Recording, Table
from groundstation.telemetry.samples import RawBatch, SampleBatch
from support.packets import (
    COPIES,
    assert_same_packets,
    assert_same_samples,
    chunks,
    flight,
    raw_batches,
    records,
    sample_batches,
    write_flight,
)

ROWS = 120
"""Five chunks of 25 samples, the last one with 20."""
SHARED_FOLDER = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
"""Each example writes its file anew, so the folder may be shared."""
WORDS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
ENTRIES = st.lists(
    st.dictionaries(WORDS, st.none() | st.booleans() | st.integers(-(2**53), 2**53) | WORDS).map(
        lambda entry: {**entry, "time_ns": 1_700_000_000_000_000_000}
    ),
    max_size=3,
)
METADATA = st.dictionaries(
    WORDS.filter(lambda name: name != "channels"),
    st.dictionaries(WORDS.filter(lambda key: key != "crc32"), WORDS, max_size=3),
    max_size=3,
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    path = tmp_path_factory.mktemp("finished") / "flight.mcap"
    write_flight(path, ROWS)
    return path.read_bytes()


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    path = tmp_path_factory.mktemp("killed") / "flight.mcap"
    write_flight(path, ROWS, finish=False)
    return path.read_bytes()


@SHARED_FOLDER
@given(
    batches=st.sampled_from([1e-6, 73e-6 / 72]).flatmap(
        lambda tick_s: st.lists(sample_batches(tick_s=tick_s), max_size=3)
    ),
    raw=st.lists(raw_batches(), max_size=3),
    commands=ENTRIES,
    events=ENTRIES,
    metadata=METADATA,
)
def test_any_recording_comes_back_bit_for_bit(tmp_path, batches, raw, commands, events, metadata):
    path = tmp_path / "any.mcap"
    path.unlink(missing_ok=True)
    recording = Recording(
        path=Path("made"),
        kind="made",
        samples=SampleBatch.concatenate(batches),
        raw=RawBatch.concatenate(raw),
        commands=commands,
        events=events,
        metadata=metadata,
    )
    write_mcap(recording, path)
    got = read_mcap(path, raw=True)
    assert_same_samples(got.samples, recording.samples)
    assert_same_packets(got.raw, recording.raw)
    assert (got.commands, got.events, got.statistics) == (commands, events, [])
    assert (got.metadata, got.damage, got.kind) == (metadata, [], "mcap")


def test_tables_keep_their_names_types_and_values(path):
    columns = {
        "stateEstimate.x": np.linspace(0, 1, 2500, dtype=np.float32),
        "stateEstimate.X": np.arange(2500, dtype=np.uint16),
        "2nd": np.arange(2500, dtype=np.int64) - 5,
        "è": np.arange(2500) % 2 == 0,
    }
    table = Table(np.arange(2500) * 0.01, columns)
    write_mcap(Recording(path, "microsd", flight(0, 10)[1], tables={"mocap event": table}), path)
    got = read_mcap(path).tables["mocap event"]
    np.testing.assert_array_equal(got.time_s, table.time_s)
    assert list(got.columns) == list(columns)
    for name, column in columns.items():
        np.testing.assert_array_equal(got.columns[name], column)
        assert got.columns[name].dtype == (np.uint8 if column.dtype == bool else column.dtype)


def test_a_table_of_text_is_refused_and_leaves_no_file(path):
    table = Table(np.zeros(2), {"note": np.array(["a", "b"])})
    recording = Recording(path, "csv", flight(0, 10)[1], tables={"notes": table})
    with pytest.raises(RecordingError, match="column note"):
        write_mcap(recording, path)
    assert not path.exists()


def test_writing_to_a_full_disk_leaves_no_file(small_disk):
    recording = Recording(small_disk, "csv", flight(0, 40_000)[1], flight(0, 40_000)[0])
    with pytest.raises(RecordingError, match="No space left"):
        write_mcap(recording, small_disk / "flight.mcap")
    assert list(small_disk.iterdir()) == []


def test_packets_are_read_only_where_they_are_asked_for(path, finished):
    path.write_bytes(finished)
    assert read_mcap(path).raw is None
    assert_same_packets(read_mcap(path, raw=True).raw, flight(0, ROWS)[0])


def test_a_recording_that_is_still_growing_reads(path):
    out = RecordingFile(path, {})
    out.samples(flight(0, 50)[1])
    out.file.flush()
    recording = read_mcap(path)
    assert_same_samples(recording.samples, flight(0, 50)[1])
    assert (recording.damage, recording.being_written) == ([], True)
    left = path.with_name("left.mcap")  # as a killed recorder leaves it
    left.write_bytes(path.read_bytes())
    assert read_mcap(left).damage == [
        f"byte {path.stat().st_size}: the recording was not finished: it ends without an index, "
        "after 0.098 s of the recording"
    ]
    out.samples(flight(50, 50)[1])
    out.finish()
    assert_same_samples(read_mcap(path).samples, flight(0, 100)[1])


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"enable_crcs": False},
        {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False},
        {"enable_data_crcs": True, "chunk_size": 1000},
    ],
)
def test_a_recording_that_another_tool_rewrote_reads(path, finished, options):
    source = path.with_name("source.mcap")
    source.write_bytes(finished)
    with source.open("rb") as file, path.open("wb") as out:
        writer = Writer(out, **options)
        writer.start()
        writer.add_metadata("session", {"link": "rewritten"})
        ids = {}
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.id not in ids:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id
                )
            writer.add_message(
                ids[channel.id], message.log_time, message.data, message.publish_time
            )
        writer.finish()
    recording = read_mcap(path, raw=True)
    assert_same_samples(recording.samples, flight(0, ROWS)[1])
    assert_same_packets(recording.raw, flight(0, ROWS)[0])
    assert (recording.link, recording.damage) == ("rewritten", [])


def places_of_every_kind(data):
    """Just before, at and behind every record's start, and in the middle of each."""
    for start, _, end in records(data):
        yield from (start - 1, start, start + 1, start + 8, start + 9, (start + end) // 2)


def test_a_file_torn_at_any_kind_of_place_gives_everything_before_the_tear(path, finished):
    ends = [end for _, end in chunks(finished)]
    expected = flight(0, ROWS)[1]
    torn = 0
    for cut in places_of_every_kind(finished):
        if cut < ends[0]:
            continue
        path.write_bytes(finished[:cut])
        whole_chunks = sum(end <= cut for end in ends)
        recording = read_mcap(path)
        assert_same_samples(recording.samples, expected[: min(25 * whole_chunks, ROWS)])
        assert len(recording.events) == whole_chunks
        assert len(recording.damage) == 1
        assert recording.damage[0].startswith("byte ")
        torn += 1
    assert torn > 100


def test_a_file_torn_before_its_first_chunk_has_no_samples_and_says_so(path, finished):
    path.write_bytes(finished[: chunks(finished)[0][0]])
    recording = read_mcap(path)
    assert len(recording.samples) == 0
    assert "not finished" in recording.damage[0]
    assert recording.link == "made"


@pytest.mark.parametrize("length", range(1, 8))
def test_a_file_torn_in_its_first_bytes_is_one_clear_line(path, finished, length):
    path.write_bytes(finished[:length])
    with pytest.raises(RecordingError, match="ends within the first 8 bytes"):
        read_mcap(path)


def test_a_bad_chunk_costs_that_chunk_and_its_time_is_told(path, finished):
    data = bytearray(finished)
    start, end = chunks(finished)[2]
    data[(start + end) // 2] ^= 0x10
    path.write_bytes(data)
    recording = read_mcap(path, raw=True)
    rows = np.r_[0:50, 75:ROWS]
    assert_same_samples(recording.samples, flight(0, ROWS)[1][rows])
    assert len(recording.raw) == COPIES * len(rows)
    assert len(recording.damage) == 1
    assert recording.damage[0].startswith(f"byte {start}: a chunk")
    assert f"{end - start} bytes passed over" in recording.damage[0]
    # the newest packet before it was the fourth copy of sample 49
    assert "between 0.100 s and 0.150 s" in recording.damage[0]


def flipped(at):
    def damage(data):
        data[at(chunks(data))] ^= 0x41

    return damage


def zeroed(span):
    def damage(data):
        first, last = span(chunks(data))
        data[first:last] = bytes(last - first)

    return damage


@pytest.mark.parametrize(
    ("damage", "kept", "lines"),
    [
        *((flipped(lambda c, w=w, b=b: c[w][0] + b), np.r_[0:ROWS], 1)
          for w in (0, 2, 4) for b in (0, 1, 2, 3, 8)),
        (flipped(lambda c: c[1][0] + 9 + 36), np.r_[0:25, 50:ROWS], 1),
        (zeroed(lambda c: (c[1][0] + 60, c[3][0] + 60)), np.r_[0:25, 100:ROWS], None),
    ],
    ids=[*(f"head {w} {b}" for w in (0, 2, 4) for b in (0, 1, 2, 3, 8)), "length", "zeros"],
)  # fmt: skip
def test_a_damage_costs_the_chunks_that_it_covers_and_a_record_s_head_none(
    path, finished, damage, kept, lines
):
    data = bytearray(finished)
    damage(data)
    path.write_bytes(data)
    recording = read_mcap(path)
    assert_same_samples(recording.samples, flight(0, ROWS)[1][kept])
    assert len(recording.damage) == (lines or len(recording.damage)) > 0


def test_losing_the_chunk_with_the_definitions_costs_that_chunk_alone(path, killed):
    data = bytearray(killed)
    zeroed(lambda places: places[0])(data)
    path.write_bytes(data)
    recording = read_mcap(path, raw=True)
    assert_same_samples(recording.samples, flight(25, ROWS - 25)[1])
    assert_same_packets(recording.raw, flight(25, ROWS - 25)[0])


def read_or_refused(path):
    """The recording, or None where reading it is refused in the project's own words."""
    try:
        return read_mcap(path, raw=True)
    except (BadInputError, RecordingError):
        return None


def assert_nothing_is_wrong(recording, expected):
    """What was read may be less than what was written, never something else."""
    raw, samples = expected
    rows = np.searchsorted(samples.ticks, recording.samples.ticks)
    assert_same_samples(recording.samples, samples[rows])
    assert (np.diff(rows) > 0).all()
    if recording.raw is not None:
        times = np.searchsorted(raw.host_time_ns, recording.raw.host_time_ns)
        assert_same_packets(recording.raw, RawBatch(raw.packets[times], raw.host_time_ns[times]))
    assert all(
        set(entry) == {"time_ns", "number"} and entry["number"] % 25 == 0
        for entry in recording.events
    )
    assert recording.metadata in ({}, {"session": {"link": "made"}})


def read_with_flips(path, content, data, count):
    """What is read where so many bytes differ, which is never anything else than was written."""
    damaged = bytearray(content)
    for _ in range(count):
        damaged[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    path.write_bytes(damaged)
    recording = read_or_refused(path)
    if recording is not None:
        assert_nothing_is_wrong(recording, flight(0, ROWS))
    return recording


@SHARED_FOLDER
@given(st.data())
def test_any_flipped_byte_of_a_finished_file_is_noticed(path, finished, data):
    recording = read_with_flips(path, finished, data, 1)
    if recording is not None:
        assert recording.damage
        assert len(recording.samples) >= ROWS - 25


@SHARED_FOLDER
@given(st.data())
def test_a_flipped_byte_of_a_killed_recording_never_passes_for_data(path, killed, data):
    recording = read_with_flips(path, killed, data, 1)
    if recording and (len(recording.samples) < ROWS or not recording.metadata):
        assert len(recording.damage) > 1 or "passed over" in recording.damage[0]


@SHARED_FOLDER
@given(st.data())
def test_many_flipped_bytes_never_pass_for_data(path, finished, data):
    read_with_flips(path, finished, data, data.draw(st.integers(2, 20)))


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "is empty"),
        (b"Timestamp,Battery\n1,2\n" * 50, "not an MCAP file"),
        (bytes(100_000), "not an MCAP file"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "not an MCAP file"),
    ],
)
def test_a_file_that_is_no_recording_is_one_clear_line(path, content, line):
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=line) as caught:
        read_mcap(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def write_foreign(path, topic="/camera", encoding="json", finish=True):
    with path.open("wb") as out:
        writer = Writer(out)
        writer.start()
        channel = writer.register_channel(topic, encoding, 0)
        for k in range(10):
            writer.add_message(channel, k, b"{}", k)
        writer.flush()
        if finish:
            writer.finish()


@pytest.mark.parametrize("finish", [True, False])
def test_a_recording_of_another_program_is_one_clear_line(path, finish):
    write_foreign(path, finish=finish)
    with pytest.raises(RecordingError, match=r"of another program, without .* topics: /camera"):
        read_mcap(path)


def test_a_topic_of_ours_in_a_layout_that_is_not_ours_is_refused(path):
    write_foreign(path, topic="/telemetry/samples")
    with pytest.raises(RecordingError, match="/telemetry/samples is not in the layout"):
        read_mcap(path)


def test_a_definition_that_lacks_a_field_is_refused(path):
    with path.open("wb") as out:
        writer = Writer(out)
        writer.start()
        schema = writer.register_schema("other_msgs/msg/Samples", "ros2msg", b"int64[] ticks\n")
        channel = writer.register_channel("/telemetry/samples", "cdr", schema)
        writer.add_message(channel, 1, b"\0\1\0\0\0\0\0\0", 1)
        writer.finish()
    with pytest.raises(RecordingError, match="/telemetry/samples: has no tick_s"):
        read_mcap(path)


def test_a_recording_from_before_a_row_had_two_settings_is_read(path):
    samples = flight(0, 50)[1]
    text, _, _ = SAMPLES_DEFINITION.text.partition("float32[] duty_step")
    with path.open("wb") as out:
        writer = Writer(out)
        writer.start()
        schema = writer.register_schema("groundstation_msgs/msg/Samples", "ros2msg", text.encode())
        channel = writer.register_channel("/telemetry/samples", "cdr", schema)
        values = {field: getattr(samples, name) for name, (field, _) in SAMPLE_FIELDS.items()}
        message = {**values, "tick_s": samples.tick_s}
        writer.add_message(channel, 1, Definition.parse(text).encode(message), 1)
        writer.finish()
    assert_same_samples(read_mcap(path).samples, samples)


def test_messages_that_do_not_decode_are_counted_not_guessed(path):
    out = RecordingFile(path, {})
    out.samples(flight(0, 50)[1])
    out.add("/telemetry/samples", 1, b"\0\1\0\0garbage")
    out.add("/telemetry/raw", 1, b"")
    out.add("/link/events", 1, b"[1]")
    out.finish()
    recording = read_mcap(path, raw=True)
    assert_same_samples(recording.samples, flight(0, 50)[1])
    assert len(recording.damage) == 3
    assert "/telemetry/samples: 1 messages could not be decoded" in recording.damage[0]


def test_unknown_topics_beside_ours_are_left_alone(path):
    out = RecordingFile(path, {})
    out.samples(flight(0, 50)[1])
    schema = out.file.register_schema("", "", b"")
    channel = out.file.register_channel("/camera", "jpeg", schema, {})
    out.file.add_message(channel, 5, b"\xff\xd8")
    out.finish()
    recording = read_mcap(path)
    assert_same_samples(recording.samples, flight(0, 50)[1])
    assert recording.damage == []
