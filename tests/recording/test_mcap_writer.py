import contextlib
import errno
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory

from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.mcap_file import McapFile, McapRecorder, session_metadata, write_mcap
from groundstation.recording.mcap_reader import read_mcap
from groundstation.recording.mcap_scan import recover
from groundstation.recording.mcap_schemas import quaternion
from groundstation.recording.quality import inspect_recording
from groundstation.recording.session import Recording
from groundstation.telemetry.samples import RawBatch, SampleBatch, empty_samples
from support.packets import (
    COPIES,
    START_NS,
    assert_same_packets,
    assert_same_samples,
    flight,
    record_flight,
)
from support.programs import Program, run_program
from support.waiting import until

METADATA = {
    "session": session_metadata("stand-in"),
    "vehicle": {"name": "crazyflie1", "mass_kg": "0.019"},
    "configuration": {"rate": "500"},
}
ROWS = 1500
FAULT_S = 10.0
"""In which a recorder that looks a hundred times a second does what it has to."""
TESTS = Path(__file__).parents[1]


class Faults(list):
    """What a recorder told; heard: set once it has told something."""

    def __init__(self):
        self.heard = threading.Event()

    def __call__(self, text):
        self.append(text)
        self.heard.set()


@pytest.fixture
def faults():
    return Faults()


def test_everything_given_comes_back(path):
    events = [{"time_ns": START_NS + k, "kind": "silent", "text": f"µ {k}"} for k in range(3)]
    commands = [{"time_ns": START_NS + 5, "roll_rad": 0.25, "thrust": 40000}]
    with McapRecorder(path, METADATA) as recorder:
        record_flight(recorder, ROWS)
        for event in events:
            recorder.event(event)
        recorder.command(commands[0])
        recorder.statistics({"time_ns": START_NS + 9, "lost": np.int64(3), "rate": np.float32(2)})
    status = recorder.status()
    assert (status.state, status.dropped, status.text) == ("finished", 0, "")
    assert (status.samples, status.raw_packets) == (ROWS, ROWS * COPIES)
    assert status.bytes == path.stat().st_size

    recording = read_mcap(path, raw=True)
    raw, samples = flight(0, ROWS)
    assert_same_samples(recording.samples, samples)
    assert_same_packets(recording.raw, raw)
    assert recording.events == events
    assert recording.commands == commands
    assert recording.statistics == [{"time_ns": START_NS + 9, "lost": 3, "rate": 2.0}]
    totals = {"samples": str(ROWS), "raw_packets": str(len(raw)), "marks": "0"}
    assert recording.metadata == METADATA | {"totals": totals}
    assert recording.link == "stand-in"
    assert recording.damage == []


def test_batches_are_merged_into_messages_of_fifty_milliseconds(path):
    with McapRecorder(path, METADATA) as recorder:
        record_flight(recorder, ROWS)
    with path.open("rb") as file:
        counts = make_reader(file).get_summary().statistics.channel_message_counts
    assert counts[1] == counts[2] == pytest.approx(ROWS / 25, rel=0.2)


def test_messages_carry_the_host_time_of_their_newest_item(path):
    with McapRecorder(path, METADATA) as recorder:
        record_flight(recorder, 100)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages = list(reader.iter_decoded_messages(["/telemetry/raw", "/telemetry/samples"]))
    assert messages
    for _, _, message, decoded in messages:
        assert message.log_time == max(decoded.host_time_ns)


def test_a_reader_of_another_project_decodes_every_topic(path):
    with McapRecorder(path, METADATA) as recorder:
        record_flight(recorder, ROWS)
    raw, samples = flight(0, ROWS)
    decoded = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, _, message in reader.iter_decoded_messages():
            decoded.setdefault(channel.topic, (schema.name, []))[1].append(message)
    names = {topic: name for topic, (name, _) in decoded.items()}
    assert names == {
        "/telemetry/raw": "groundstation_msgs/msg/RawPackets",
        "/telemetry/samples": "groundstation_msgs/msg/Samples",
        "/imu": "sensor_msgs/msg/Imu",
        "/battery": "sensor_msgs/msg/BatteryState",
    }
    packets = b"".join(message.packets for message in decoded["/telemetry/raw"][1])
    assert packets == raw.packets.tobytes()
    gyro = np.concatenate([m.gyro_rad_s for m in decoded["/telemetry/samples"][1]])
    np.testing.assert_array_equal(gyro.astype(np.float32), samples.gyro.reshape(-1))
    ticks = np.concatenate([m.ticks for m in decoded["/telemetry/samples"][1]])
    np.testing.assert_array_equal(ticks, samples.ticks)

    imu = decoded["/imu"][1]
    thinned = samples[::10]
    assert len(imu) == len(thinned) == ROWS // 10
    rates = [[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z] for m in imu]
    np.testing.assert_array_equal(np.float32(rates), thinned.gyro)
    forces = [
        [m.linear_acceleration.x, m.linear_acceleration.y, m.linear_acceleration.z] for m in imu
    ]
    np.testing.assert_array_equal(np.float32(forces), thinned.accelerometer)
    turns = [[m.orientation.x, m.orientation.y, m.orientation.z, m.orientation.w] for m in imu]
    np.testing.assert_array_equal(turns, quaternion(thinned.attitude))
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in imu]
    assert stamps == thinned.host_time_ns.tolist()
    assert {m.header.frame_id for m in imu} == {"base_link"}
    volts = np.float32([message.voltage for message in decoded["/battery"][1]])
    np.testing.assert_array_equal(volts, thinned.battery_v)
    assert all(np.isnan(message.percentage) for message in decoded["/battery"][1])


def test_another_reader_finds_the_checksums_of_the_whole_file_right(path):
    with McapRecorder(path, METADATA) as recorder:
        record_flight(recorder, 500)
    with path.open("rb") as file:
        streamed = list(NonSeekingReader(file, validate_crcs=True).iter_messages())
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert len(list(reader.iter_messages())) == len(streamed) > 0
        records = {record.name: record.metadata for record in reader.iter_metadata()}
    assert records["vehicle"].items() >= METADATA["vehicle"].items()


@pytest.mark.parametrize(
    ("angles", "axis"),
    [((0.3, 0, 0), (1, 0, 0)), ((0, 0.3, 0), (0, 1, 0)), ((0, 0, 0.3), (0, 0, 1))],
)
def test_each_angle_turns_right_handed_about_its_axis(angles, axis):
    x, y, z, w = quaternion(np.array([angles]))[0]
    assert w == pytest.approx(np.cos(0.15))
    assert (x, y, z) == pytest.approx(np.sin(0.15) * np.array(axis))


def test_channels_a_source_does_not_have_are_marked_as_unknown_in_standard_messages(path):
    samples = empty_samples(100)
    samples.ticks[:] = np.arange(100) * 1973
    samples.host_time_ns[:] = START_NS
    samples.gyro[:] = 1.0
    with McapRecorder(path, METADATA) as recorder:
        recorder.samples(samples)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topics = [channel.topic for _, channel, _ in reader.iter_messages()]
        (*_, imu) = next(reader.iter_decoded_messages(["/imu"]))
    assert "/battery" not in topics
    assert imu.orientation_covariance[0] == imu.linear_acceleration_covariance[0] == -1
    assert imu.angular_velocity_covariance[0] == 0
    assert imu.angular_velocity.x == 1.0


def test_a_recording_without_data_is_a_sound_file(path):
    McapRecorder(path, METADATA).finish()
    recording = read_mcap(path, raw=True)
    assert (len(recording.samples), len(recording.raw), recording.damage) == (0, 0, [])


def test_finish_may_be_called_twice_and_later_data_are_counted_as_dropped(path):
    recorder = McapRecorder(path, METADATA)
    first = recorder.finish()
    record_flight(recorder, 10)
    recorder.event({"time_ns": 1})
    second = recorder.finish()
    assert (first.state, second.state) == ("finished", "finished")
    assert (second.dropped_samples, second.dropped_packets, second.dropped_entries) == (10, 40, 1)


def test_a_file_that_is_being_written_is_being_recorded_and_not_torn(path):
    with McapRecorder(path, METADATA, flush_s=0.01) as recorder:
        record_flight(recorder, ROWS)
        began_s = time.monotonic()
        while len((live := read_mcap(path)).samples) < ROWS:
            assert time.monotonic() - began_s < 30
        assert (live.damage, live.being_written) == ([], True)
        assert inspect_recording(live)["verdict"].startswith("being recorded, so far good")
    assert not read_mcap(path).being_written
    cut = path.with_name("cut.mcap")
    cut.write_bytes(path.read_bytes()[:-100])
    assert read_mcap(cut).damage


def test_an_existing_file_is_never_overwritten(path):
    path.write_bytes(b"precious")
    with pytest.raises(BadInputError, match="exists already"):
        McapRecorder(path, METADATA)
    assert path.read_bytes() == b"precious"


def test_a_folder_that_is_missing_is_made(tmp_path):
    McapRecorder(tmp_path / "a" / "b" / "flight.mcap", METADATA).finish()
    assert read_mcap(tmp_path / "a" / "b" / "flight.mcap").damage == []


def test_a_folder_that_is_a_file_is_one_clear_line(tmp_path):
    (tmp_path / "folder").write_bytes(b"")
    with pytest.raises(RecordingError, match="is not a folder") as caught:
        McapRecorder(tmp_path / "folder" / "flight.mcap", METADATA)
    assert "\n" not in str(caught.value)


def test_a_read_only_disk_is_one_clear_line(small_disk):
    run_program(["mount", "-o", "remount,ro", small_disk], check=True)
    with pytest.raises(RecordingError, match="cannot be created: Read-only"):
        McapRecorder(small_disk / "flight.mcap", METADATA, low_space_bytes=0)


def test_too_little_space_at_the_start_is_refused_and_leaves_no_file(path):
    with pytest.raises(RecordingError, match="MiB free"):
        McapRecorder(path, METADATA, low_space_bytes=2**62)
    assert not path.exists()


def test_under_the_low_space_mark_the_file_is_finished_cleanly(small_disk, faults):
    path = small_disk / "flight.mcap"
    recorder = McapRecorder(path, METADATA, low_space_bytes=300_000, flush_s=0.01, on_fault=faults)
    given = record_until(faults.heard.is_set, recorder)
    status = recorder.finish()
    assert status.state == "low_space"
    assert faults == [status.text]
    assert "almost full" in status.text
    assert str(path) in status.text
    recording = read_mcap(path, raw=True)
    assert recording.damage == []
    assert len(recording.samples) == status.samples
    assert status.samples + status.dropped_samples == given
    assert_same_samples(recording.samples, flight(0, status.samples)[1])


def test_a_full_disk_keeps_every_whole_chunk_and_says_so_once(small_disk, faults):
    path = small_disk / "flight.mcap"
    never = -(1 << 30)  # no room is too little to go on: the write itself has to fail
    recorder = McapRecorder(path, METADATA, low_space_bytes=never, flush_s=0.01, on_fault=faults)
    given = record_until(lambda: recorder.status().samples >= 500, recorder)
    fill(small_disk / "something_else")
    given = record_until(faults.heard.is_set, recorder, given)
    status = recorder.finish()
    assert status.state == "failed"
    assert faults == [status.text]
    assert "No space left" in status.text
    assert_holds_the_beginning(path, given)


def record_until(condition, recorder, given=0):
    """Go on with the flight from sample ``given``; how many there are in the end."""

    def holds():
        nonlocal given
        record_flight(recorder, 100, first=given)
        given += 100
        return condition()

    until(holds, "what ends the recording", FAULT_S)
    return given


def fill(path):
    """Use up the disk that ``path`` is on."""
    with path.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))


def test_a_disk_error_stops_the_recording_and_spares_the_caller(path):
    """The size limit of a process is a write error that needs no special rights."""
    done = run_program(
        [sys.executable, "-c", SIZE_LIMIT, path],
        env={**os.environ, "PYTHONPATH": str(TESTS)},
    )
    assert done.stderr == ""
    state, *text = done.stdout.splitlines()
    assert state == "failed"
    assert text == [f"{path}: recording stopped: File too large; what was written is kept"]
    assert_holds_the_beginning(path, 20_000)


SIZE_LIMIT = """
import resource, sys, threading
from pathlib import Path
from support.packets import record_flight
from groundstation.recording.mcap_file import McapRecorder
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
heard = threading.Event()
texts = []
recorder = McapRecorder(
    Path(sys.argv[1]), {}, flush_s=0.01, on_fault=lambda text: (texts.append(text), heard.set())
)
given = 0
while not heard.is_set():
    record_flight(recorder, 100, first=given)
    given += 100
    heard.wait(0.005)
print(recorder.finish().state)
print(*texts, sep="\\n")
"""


def assert_holds_the_beginning(path, rows):
    """The file ends after a whole chunk, and what it holds is the flight's beginning."""
    recording = read_mcap(path, raw=True)
    kept = len(recording.samples)
    assert 0 < kept <= rows
    assert len(recording.damage) == 1
    assert "not finished" in recording.damage[0]
    assert_same_samples(recording.samples, flight(0, kept)[1])
    assert_same_packets(recording.raw, flight(0, len(recording.raw) // COPIES)[0])


@pytest.mark.parametrize("left", [0, 1000])
def test_a_file_that_another_program_cuts_is_a_fault_and_has_no_hole(path, faults, left):
    """``> flight.mcap`` in a shell, say: what is written behind it would stand after zeros."""
    raw, samples = flight(0, 500)
    recorder = McapRecorder(path, METADATA, on_fault=faults, flush_s=0.02)
    recorder.raw(raw)
    recorder.samples(samples)
    deadline_s = time.monotonic() + 20.0
    while path.stat().st_size <= 1000:  # written, not only taken
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
    os.truncate(path, left)
    while recorder.status().state == "recording":
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
    recorder.finish()
    (fault,) = faults
    assert fault.startswith(f"{path}: recording stopped: another program cut the file to ")
    assert bytes(512) not in path.read_bytes()[left:]


def test_one_damage_in_a_converted_recording_costs_a_second_or_two(path):
    _, samples = flight(0, 10_000)  # 20 s in one piece
    write_mcap(Recording(path=path, kind="csv", samples=samples), path)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    report = recover(path)
    assert report.chunks_skipped == 1
    assert 0.0 < report.seconds_lost < 3.0


def test_a_removed_file_is_a_fault(path, faults):
    recorder = McapRecorder(path, METADATA, flush_s=0.01, on_fault=faults)
    record_flight(recorder, 100)
    path.unlink()
    assert faults.heard.wait(10)
    record_flight(recorder, 100, first=100)
    status = recorder.finish()
    assert status.state == "failed"
    assert faults == [f"{path}: recording stopped: the file was removed"]


def test_a_listener_that_fails_does_not_harm_the_recording(path):
    def listen(text):
        raise ZeroDivisionError

    recorder = McapRecorder(path, METADATA, flush_s=0.01, on_fault=listen)
    path.unlink()
    assert_ends(recorder)
    assert recorder.finish().state == "failed"


def assert_ends(recorder):
    """Feed the recorder until it has stopped by itself."""
    for start in range(0, 10_000_000, 100):
        record_flight(recorder, 100, first=start)
        if recorder.status().state != "recording":
            return
    pytest.fail("the recorder did not stop")


def test_a_fault_of_the_recorder_itself_keeps_what_was_written(path, faults):
    recorder = McapRecorder(path, METADATA, flush_s=0.01, on_fault=faults)
    record_flight(recorder, 500)
    raw, _ = flight(500, 5)
    recorder.raw(RawBatch(raw.packets, raw.host_time_ns.astype("U")))
    assert faults.heard.wait(10)
    assert recorder.finish().state == "failed"
    assert "internal fault" in faults[0]
    recording = read_mcap(path)
    assert_same_samples(recording.samples, flight(0, len(recording.samples))[1])
    assert recording.damage == []


def test_an_overflowing_queue_counts_what_it_drops_and_never_blocks(path, faults, monkeypatch):
    """The disk stands still: a write that does not return until the test lets it."""
    disk = threading.Event()
    flush = McapFile.flush

    def slow_flush(file):
        if threading.current_thread().name == "recorder":
            assert disk.wait(60)
        flush(file)

    monkeypatch.setattr(McapFile, "flush", slow_flush)
    recorder = McapRecorder(path, METADATA, flush_s=0.01, queue_bytes=100_000, on_fault=faults)
    record_flight(recorder, ROWS, batch=50)
    waiting = recorder.status()
    assert waiting.dropped_samples > 0
    assert waiting.dropped_packets > 0
    disk.set()
    status = recorder.finish()
    assert status.state == "finished"
    assert status.samples + status.dropped_samples == ROWS
    assert status.raw_packets + status.dropped_packets == ROWS * COPIES
    assert any("too slow" in text for text in faults)
    recording = read_mcap(path, raw=True)
    assert len(recording.samples) == status.samples
    assert len(recording.raw) == status.raw_packets
    expected = flight(0, ROWS)[1]
    rows = np.searchsorted(expected.ticks, recording.samples.ticks)
    assert_same_samples(recording.samples, expected[rows])


def test_what_came_a_moment_ago_is_in_the_file_while_the_recording_goes_on(path):
    with McapRecorder(path, METADATA, flush_s=0.01) as recorder:
        record_flight(recorder, 100)
        until(lambda: len(read_mcap(path).samples) == 100, "the samples in the file", FAULT_S)


def test_a_slow_sync_does_not_keep_data_from_the_operating_system(path, monkeypatch):
    """A memory card may take seconds; a killed process must not lose them."""
    syncing, disk = threading.Event(), threading.Event()

    def slow_sync(file):
        syncing.set()
        assert disk.wait(60)

    monkeypatch.setattr(McapFile, "sync", slow_sync)
    recorder = McapRecorder(path, METADATA, flush_s=0.01)
    record_flight(recorder, 100)
    assert syncing.wait(FAULT_S)
    record_flight(recorder, 100, first=100)
    until(lambda: len(read_mcap(path).samples) == 200, "the samples in the file", FAULT_S)
    assert_same_samples(read_mcap(path).samples, flight(0, 200)[1])
    disk.set()
    assert recorder.finish().state == "finished"


def test_a_failing_sync_is_a_fault(path, faults, monkeypatch):
    def failing_sync(file):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(McapFile, "sync", failing_sync)
    recorder = McapRecorder(path, METADATA, flush_s=0.01, on_fault=faults)
    record_until(faults.heard.is_set, recorder)
    assert recorder.finish().state == "failed"
    assert "Input/output error" in faults[0]


def test_the_name_of_a_new_file_and_the_whole_of_a_finished_one_are_on_the_disk(path, monkeypatch):
    synced, sync = [], os.fsync

    def noting_sync(fd):
        status = os.fstat(fd)
        synced.append((status.st_ino, status.st_size))
        sync(fd)

    monkeypatch.setattr(os, "fsync", noting_sync)
    recorder = McapRecorder(path, METADATA)
    assert [inode for inode, _ in synced] == [path.parent.stat().st_ino]
    record_flight(recorder, 100)
    recorder.finish()
    assert synced[1:] == [(path.stat().st_ino, path.stat().st_size)]


def test_what_the_system_takes_in_pieces_is_written_whole(path, monkeypatch):
    write = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: write(fd, data[:1000]))
    with McapRecorder(path, METADATA) as recorder:
        record_flight(recorder, 100)
    recording = read_mcap(path)
    assert recording.damage == []
    assert_same_samples(recording.samples, flight(0, 100)[1])


def test_samples_of_another_clock_start_a_new_message(path):
    first = flight(0, 50)[1]
    other = flight(50, 50)[1]
    other = SampleBatch(**{**columns(other), "tick_s": 1e-6})
    with McapRecorder(path, METADATA) as recorder:
        recorder.samples(first)
        recorder.samples(other)
    samples = read_mcap(path).samples
    assert samples.tick_s == first.tick_s
    np.testing.assert_array_equal(samples.ticks[:50], first.ticks)
    expected_s = other.ticks * 1e-6
    np.testing.assert_allclose(samples.time_s[50:], expected_s, rtol=0, atol=first.tick_s / 2)


def columns(batch):
    return {name: getattr(batch, name) for name in batch.__slots__}


CHILD = """
import os, sys, time
from pathlib import Path
from support.packets import flight
from groundstation.recording.mcap_file import McapRecorder
recorder = McapRecorder(Path(sys.argv[1]), {"session": {"link": "kill"}})
due = time.monotonic()
for start in range(0, 1_000_000, 5):
    raw, samples = flight(start, 5)
    recorder.raw(raw)
    recorder.samples(samples)
    os.write(1, b"%d\\n" % (start + 5))
    due = max(due + 0.01, time.monotonic())  # never faster than the real rate, however held up
    time.sleep(max(0.0, due - time.monotonic()))
"""


def start_child(path):
    return Program(
        [sys.executable, "-c", CHILD, path],
        env={**os.environ, "PYTHONPATH": str(TESTS)},
        stdout=subprocess.PIPE,
    )


def kill_after(child, rows):
    """Kill the child once it has recorded ``rows`` samples; how many it recorded in the end."""
    given = 0
    for line in child.stdout:
        given = int(line)
        if given >= rows:
            break
    child.send_signal(signal.SIGKILL)
    last = child.stdout.read().rpartition(b"\n")[0].rpartition(b"\n")[2]
    return int(last or given)


def test_kill_9_at_a_random_moment_loses_half_a_second_at_most(tmp_path):
    """Twenty recordings at the real rate, killed 0.2 s to 1.2 s after their first sample."""
    moments = random.Random(20260801)
    lost = []
    for group in range(5):
        paths = [tmp_path / f"{group}_{k}.mcap" for k in range(4)]
        with contextlib.ExitStack() as programs:
            children = [programs.enter_context(start_child(path)) for path in paths]
            lives = sorted(moments.randint(100, 600) for _ in children)
            given = [kill_after(*pair) for pair in zip(children, lives, strict=True)]
        for path, rows in zip(paths, given, strict=True):
            try:
                report = recover(path)
            except RecordingError:  # killed before anything was on the disk: all is lost
                lost.append(rows)
                continue
            assert not report.sound
            recording = read_mcap(report.output, raw=True)
            kept = len(recording.samples)
            lost.append(rows - kept)
            assert_same_samples(recording.samples, flight(0, kept)[1])
            assert_same_packets(recording.raw, flight(0, kept)[0])
            assert recording.damage == []
            assert recording.link == "kill"
            assert_same_samples(read_mcap(path).samples, recording.samples)
    assert min(lost) >= -5
    assert sorted(lost)[14] <= 250  # of 20: a busy machine holds up a few recorders themselves
