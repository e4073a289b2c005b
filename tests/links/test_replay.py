"""Replay: the same packets with the same spacing, whatever the speed and whatever the file."""

import asyncio
import os
import time
from pathlib import Path

import numpy as np
import pytest

from groundstation.errors import BadInputError, RecordingError
from groundstation.links.replay import FAST, ReplayLink
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import RecordingFile, write_mcap
from groundstation.recording.session import Recording
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch, SampleBatch
from support.links import joined, listen, read_to_end
from support.packets import assert_same_packets, assert_same_samples, chunks, flight, write_flight

RECORDINGS = Path(__file__).parents[2] / "recordings"
EXCERPT = RECORDINGS / "thesis_excerpt.csv"
MICROSD = RECORDINGS / "microsd_log16"


def replayed(path, speed=FAST):
    """Everything that a replay delivers, its events and the link."""
    link = ReplayLink(path, speed=speed)
    events = listen(link)

    async def session():
        async with link:
            return joined(await read_to_end(link))

    return asyncio.run(session()), events, link


def from_first(stamps):
    return stamps - stamps[0]


@pytest.mark.parametrize("speed", [0.5, 1.0, 7.0, FAST])
def test_packets_and_their_spacing_are_the_recorded_ones_at_any_speed(tmp_path, speed):
    write_flight(tmp_path / "flight.mcap", 150)
    sent, _ = flight(0, 150)
    started = time.monotonic()
    got, events, _ = replayed(tmp_path / "flight.mcap", speed)
    np.testing.assert_array_equal(got.packets, sent.packets)
    np.testing.assert_array_equal(from_first(got.host_time_ns), from_first(sent.host_time_ns))
    span_s = (sent.host_time_ns[-1] - sent.host_time_ns[0]) * 1e-9
    assert time.monotonic() - started >= span_s / speed  # never ahead of its time
    assert [event.kind for event in events] == ["opening", "streaming", "ended", "closed"]


def test_a_long_recording_comes_whole_through_many_batches(tmp_path):
    write_flight(tmp_path / "flight.mcap", 5000, chunk_rows=999)
    sent, samples = flight(0, 5000)
    got, _, link = replayed(tmp_path / "flight.mcap")
    np.testing.assert_array_equal(got.packets, sent.packets)
    np.testing.assert_array_equal(from_first(got.host_time_ns), from_first(sent.host_time_ns))
    again, counts = decode_all(got, link.start_ticks)
    np.testing.assert_array_equal(again.ticks, samples.ticks)
    assert counts.duplicates == 3 * 5000


def test_the_real_excerpt_replays_with_its_own_device_time():
    source = open_recording(EXCERPT, raw=True)
    got, _, link = replayed(EXCERPT, speed=1.0)
    np.testing.assert_array_equal(got.packets, source.raw.packets)
    np.testing.assert_array_equal(from_first(got.host_time_ns), from_first(source.raw.host_time_ns))
    assert link.start_ticks == 17114118
    samples, counts = decode_all(got, link.start_ticks)
    np.testing.assert_array_equal(samples.ticks, source.samples.ticks)
    assert (counts.samples, counts.lost) == (25, 0)


def test_the_excerpt_as_mcap_replays_as_the_excerpt_as_csv():
    from_csv, _, one = replayed(EXCERPT)
    from_mcap, _, other = replayed(RECORDINGS / "thesis_excerpt.mcap")
    np.testing.assert_array_equal(from_csv.packets, from_mcap.packets)
    assert one.start_ticks == other.start_ticks


def test_a_microsd_log_replays_as_samples():
    source = open_recording(MICROSD).samples
    got, events, _ = replayed(MICROSD)
    assert isinstance(got, SampleBatch)
    shift = got.host_time_ns[0] - source.host_time_ns[0]
    source.host_time_ns[:] += shift
    assert_same_samples(got, source)
    assert [event.kind for event in events] == ["opening", "streaming", "ended", "closed"]


def test_a_microsd_log_converted_to_mcap_replays_as_the_same_samples(tmp_path):
    write_mcap(open_recording(MICROSD), tmp_path / "log.mcap")
    original, _, _ = replayed(MICROSD)
    converted, _, _ = replayed(tmp_path / "log.mcap")
    np.testing.assert_array_equal(original.ticks, converted.ticks)
    np.testing.assert_array_equal(original.gyro, converted.gyro)


def test_a_torn_recording_delivers_its_good_part_and_tells_of_the_damage(tmp_path):
    path = tmp_path / "torn.mcap"
    write_flight(path, 500, chunk_rows=100, finish=False)
    data = path.read_bytes()
    start, end = chunks(data)[-1]
    path.write_bytes(data[: (start + end) // 2])
    sent, _ = flight(0, 400)
    got, events, _ = replayed(path)
    np.testing.assert_array_equal(got.packets, sent.packets)
    damage = [event for event in events if event.kind == "damage"]
    assert damage
    assert all(str(path) in event.text and "\n" not in event.text for event in damage)


def test_a_damaged_chunk_costs_its_own_packets_only(tmp_path):
    path = tmp_path / "damaged.mcap"
    write_flight(path, 500, chunk_rows=100)
    data = bytearray(path.read_bytes())
    start, end = chunks(bytes(data))[2]
    data[(start + end) // 2] ^= 0x10
    path.write_bytes(data)
    sent, _ = flight(0, 500)
    got, events, _ = replayed(path)
    kept = np.r_[0:800, 1200:2000]
    np.testing.assert_array_equal(got.packets, sent.packets[kept])
    assert "damage" in [event.kind for event in events]


def with_a_pause(folder, *parts):
    path = folder / "pause.mcap"
    out = RecordingFile(path, {})
    for part in parts:
        out.raw(part)
    out.finish()
    return path


async def test_a_pause_in_the_recording_is_a_silence_in_the_replay(tmp_path):
    before, after = flight(0, 50)[0], flight(250, 50)[0]
    link = ReplayLink(with_a_pause(tmp_path, before, after))
    link.silence_s = 0.15
    events = listen(link)
    async with link:
        got = joined(await read_to_end(link))
    np.testing.assert_array_equal(got.packets, RawBatch.concatenate([before, after]).packets)
    kinds = [event.kind for event in events]
    assert kinds == ["opening", "streaming", "silent", "streaming", "ended", "closed"]


def test_during_a_pause_the_present_lies_inside_the_pause_at_any_speed(tmp_path):
    """Or a slow replay would have its silences taken for longer ones."""
    path = with_a_pause(tmp_path, flight(0, 10)[0], flight(1000, 10)[0])
    link = ReplayLink(path, speed=0.05)
    link.silence_s = 0.01

    async def session():
        async with link:
            last_ns, now_ns = 0, 0
            while True:
                batch = await link.read()
                if batch is not None:
                    last_ns = int(batch.host_time_ns[-1])
                now_ns = link.now_ns()
                if last_ns and now_ns > last_ns + 20_000_000:
                    return now_ns - last_ns

    assert asyncio.run(session()) < 2_000_000_000


@pytest.mark.parametrize(
    ("content", "error", "says"),
    [
        (b"", RecordingError, "is empty"),
        (b"\x00\x01\x02not a recording", RecordingError, "neither MCAP"),
        (None, BadInputError, "no such file"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_one_line(tmp_path, content, error, says):
    path = tmp_path / "file.bin"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(error, match=says) as refused:
        replayed(path)
    assert "\n" not in str(refused.value)


def test_a_pipe_is_refused_and_nobody_waits_for_its_writer(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BadInputError, match="not a file"):
        asyncio.run(ReplayLink(tmp_path / "pipe").open())


def test_a_recording_without_telemetry_is_refused(tmp_path):
    path = tmp_path / "events.mcap"
    out = RecordingFile(path, {"session": {"link": "none"}})
    out.entry("/link/events", {"time_ns": 1, "text": "nothing came"})
    out.finish()
    with pytest.raises(BadInputError, match="holds no telemetry"):
        replayed(path)


def test_packets_that_were_recorded_again_are_identical(tmp_path):
    write_flight(tmp_path / "flight.mcap", 300)
    once, _, _ = replayed(tmp_path / "flight.mcap")
    write_mcap(Recording(tmp_path, "mcap", decode_all(once)[0], once), tmp_path / "again.mcap")
    again, _, _ = replayed(tmp_path / "again.mcap")
    again.host_time_ns[:] += once.host_time_ns[0] - again.host_time_ns[0]
    assert_same_packets(again, once)
