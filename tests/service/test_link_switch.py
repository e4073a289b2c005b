"""Another link takes over while the daemon runs: real replays and a real stand-in."""

import asyncio
import os
import threading
from pathlib import Path

import numpy as np
import pytest

from groundstation.errors import BadInputError, GroundStationError, LinkError, TakenError
from groundstation.links import serial as serial_module
from groundstation.links.factory import LINKS
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_scan import McapScan
from groundstation.recording.mcap_schemas import (
    EVENTS_TOPIC,
    RAW_DEFINITION,
    RAW_TOPIC,
    decode_entry,
)
from groundstation.service import control
from groundstation.service import craft_links as receiver_module
from groundstation.service.config import ViewerConfig
from groundstation.service.control import permitted_link
from support import RECORDINGS
from support.worlds import running, station_on

FLIGHT = RECORDINGS / "stand_in_flight.mcap"


def run(tmp_path, conversation, *, link="stand-in", **options):
    """Runs a conversation with a recording station; the station and what it recorded."""

    async def session():
        station = station_on(link, tmp_path / "sessions", **options)
        async with running(station):
            await samples(station, 200)
            await conversation(station)
        return station

    station = asyncio.run(session())
    (path,) = (tmp_path / "sessions").glob("*.mcap")
    return station, open_recording(path, raw=True)


async def samples(station, count):
    """Wait until the present link has given so many samples."""
    async with asyncio.timeout(60):
        while station.receiver.decoder.counts().samples + station.receiver._ready_made < count:
            await asyncio.sleep(0.01)


def silence_s(recording):
    """The longest time without a packet around a change of segment."""
    host, segment = recording.samples.host_time_ns, recording.samples.segment
    return max(np.diff(host)[np.diff(segment) != 0]) * 1e-9


def require_parts(path, replayed):
    """In the file's order, the packets between two switches are those of the link of the moment."""
    parts = [[]]
    with McapScan(path) as scan:
        for channel, _, _, payload in scan.messages():
            topic = scan.topic(channel)
            if topic == EVENTS_TOPIC and decode_entry(payload)["kind"] == "link":
                parts.append([])
            elif topic == RAW_TOPIC:
                parts[-1].append(np.asarray(RAW_DEFINITION.decode(payload)["packets"], np.uint8))
    first, second, third, fourth = (
        np.concatenate([*part, np.empty(0, np.uint8)]) for part in parts
    )
    np.testing.assert_array_equal(second.reshape(-1, 32), replayed[: len(second) // 32])
    assert len(second) > 0
    known = {row.tobytes() for row in replayed}
    for other in (first, third):
        assert len(other) > 0
        assert not known & {row.tobytes() for row in other.reshape(-1, 32)}
    assert len(fourth) == 0, "a microSD log has samples only"


def test_the_recording_goes_on_with_a_new_segment_and_no_sample_is_misplaced(tmp_path):
    async def conversation(station):
        for name in (f"replay:{FLIGHT}", "stand-in", f"replay:{RECORDINGS / 'microsd_log16'}"):
            await station.switch_link(name)
            assert control.status_of(station)["link"]["name"] == name
            await samples(station, 300)

    # not the recorded flight
    station, recording = run(tmp_path, conversation, stand_in={"seed": 5})
    totals = station.receiver.totals()
    assert totals["samples"] == len(recording.samples), "the closing line counts every link"
    assert totals["packets"] == len(recording.raw.packets)
    assert recording.damage == []
    segment = recording.samples.segment
    assert np.unique(segment).tolist() == [0, 1, 2, 3]
    assert (np.diff(segment) >= 0).all(), "nothing of a link comes after its successor"
    replayed = recording.samples[segment == 1]
    whole = open_recording(FLIGHT, raw=True)
    source = whole.samples
    np.testing.assert_array_equal(replayed.ticks, source.ticks[: len(replayed)])
    np.testing.assert_array_equal(replayed.gyro, source.gyro[: len(replayed)])
    for number in (0, 2):
        ticks = recording.samples.ticks[segment == number]
        assert np.diff(ticks).max() < 1.5 * np.median(np.diff(ticks)), "the stand-in lost nothing"
    require_parts(recording.path, whole.raw.packets)
    told = [event["text"] for event in recording.events if event["kind"] == "link"]
    assert told[0] == f"switched from stand-in to replay:{FLIGHT}"
    assert len(told) == 3
    print(f"without data for {silence_s(recording):.3f} s at most")


def test_where_the_other_link_cannot_be_opened_the_present_one_stays(tmp_path):
    async def conversation(station):
        for name, says in (
            ("replay:nowhere.mcap", "nowhere"),
            ("serial:/dev/nothing", "nothing"),
            ("usb", "USB"),
            ("stand-in", "already"),
            ("banana", "not known"),
        ):
            with pytest.raises(GroundStationError, match=says):
                await station.switch_link(name)
        before = station.receiver.decoder.counts().samples
        await samples(station, before + 200)
        assert (
            control.status_of(station)["link"] | {"name": "stand-in", "state": "streaming"}
            == (control.status_of(station)["link"])
        )

    _, recording = run(tmp_path, conversation)
    assert set(recording.samples.segment) == {0}
    ticks = recording.samples.ticks
    assert np.diff(ticks).max() < 1.5 * np.median(np.diff(ticks))


def test_a_link_that_never_opens_is_given_up_and_the_present_one_stays(tmp_path, monkeypatch):
    asked = threading.Event()

    def hang(port, baud):
        asked.wait()
        raise LinkError("nobody listens any more")

    monkeypatch.setattr(serial_module, "_open_port", hang)
    monkeypatch.setattr(receiver_module, "OPEN_MOST_S", 0.3)

    async def conversation(station):
        before = station.receiver.decoder.counts().samples
        with pytest.raises(LinkError, match=r"has not opened within 0.3 s, so the present link"):
            await station.switch_link("serial:/dev/ttyUSB0")
        await samples(station, before + 200)
        assert control.status_of(station)["link"]["name"] == "stand-in"
        await station.switch_link(f"replay:{FLIGHT}")

    try:
        run(tmp_path, conversation)
    finally:
        asked.set()


def test_while_a_client_commands_the_link_stays(tmp_path, monkeypatch):
    async def conversation(station):
        monkeypatch.setattr(type(station.commander), "client", "pilot")
        with pytest.raises(TakenError, match="pilot is commanding; it must release first"):
            await station.switch_link(f"replay:{FLIGHT}")

    run(tmp_path, conversation)


async def test_a_replay_that_has_ended_on_view_gives_way_and_recording_begins_again(tmp_path):
    from support.programs import free_port

    async def conversation(station):
        async with asyncio.timeout(60):
            while control.status_of(station)["recording"]["state"] != "finished":
                await asyncio.sleep(0.02)
            await station.switch_link("stand-in")
            await samples(station, 200)
        assert control.status_of(station)["recording"]["state"] == "recording"

    viewer = ViewerConfig(mode="serve", port=free_port(), web_port=free_port())
    station = station_on(f"replay:{RECORDINGS / 'thesis_excerpt.csv'}", tmp_path, viewer=viewer)
    async with running(station):
        await conversation(station)
    first, second = sorted(tmp_path.glob("*.mcap"))
    assert len(open_recording(first).samples) == 25
    assert len(open_recording(second).samples) > 100


def test_another_link_that_reads_files_is_held_to_the_recordings_folder_too(tmp_path, monkeypatch):
    monkeypatch.setitem(LINKS, "tape:FILE", "replay")
    assert permitted_link("tape:flight.log", tmp_path) == f"tape:{tmp_path.resolve()}/flight.log"
    with pytest.raises(BadInputError, match="--link tape:FILE"):
        permitted_link("tape:/etc/passwd", tmp_path)


def test_another_link_whose_argument_nobody_knows_how_to_hold_is_not_chosen_by_a_request(
    tmp_path, monkeypatch
):
    monkeypatch.setitem(LINKS, "tcp:HOST", "replay")
    with pytest.raises(BadInputError, match="cannot choose a HOST; start a daemon with --link"):
        permitted_link("tcp:example.org", tmp_path)


@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        ("stand-in", True),
        ("usb", True),
        ("replay:flight.mcap", True),
        ("replay:sub/flight.mcap", True),
        ("replay:../flight.mcap", False),
        ("replay:/etc/passwd", False),
        ("replay:escape/passwd", False),
        ("replay:a\0b", False),
        ("replay:circle", False),
        ("replay:pipe", False),
        ("replay:.", False),
        ("serial:/dev/ttyUSB0", True),
        ("serial:/etc/passwd", False),
        ("serial:/dev/../etc/passwd", False),
    ],
)
def test_no_path_of_a_request_leaves_the_recordings_folder(tmp_path, name, allowed):
    (tmp_path / "escape").symlink_to("/etc")
    (tmp_path / "circle").symlink_to("circle")
    os.mkfifo(tmp_path / "pipe")
    if allowed:
        kind, _, argument = permitted_link(name, tmp_path).partition(":")
        assert kind != "replay" or Path(argument).is_relative_to(tmp_path.resolve())
    else:
        with pytest.raises(BadInputError):
            permitted_link(name, tmp_path)
