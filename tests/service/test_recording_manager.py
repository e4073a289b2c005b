"""Rotation, resuming and retention, on a flying stand-in."""

import asyncio
import errno
import os
import time

import numpy as np
import pytest

from groundstation.errors import BadInputError
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import McapRecorder
from groundstation.recording.mcap_scan import catalogue
from groundstation.service import control, recording_manager
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from groundstation.service.recording_manager import delete_oldest
from groundstation.service.station import Station
from support.waiting import eventually
from support.worlds import running


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs a conversation with a station that looks after its recordings ten times as often."""
    monkeypatch.setattr(recording_manager, "CHECK_S", 0.05)

    def run(conversation, *, speed=1.0, **recording):
        async def session():
            options = {"folder": str(tmp_path / "sessions"), "low_space_mb": 0, **recording}
            link, kept = LinkConfig(speed=speed), RecordingConfig(**options)
            station = Station(Config(link=link, recording=kept))
            async with running(station):
                await eventually(lambda: recorded(station) > 100)
                await conversation(station)
            return station

        return asyncio.run(session())

    return run


def recorded(station):
    return control.status_of(station)["recording"]["samples"]


def files(tmp_path):
    return sorted((tmp_path / "sessions").glob("*.mcap"))


def require_nothing_lost(station, paths):
    """Put together, the files hold everything that arrived, once and in order."""
    parts = [open_recording(path, raw=True) for path in paths]
    assert [part.damage for part in parts] == [[]] * len(parts)
    ticks = np.concatenate([part.samples.ticks for part in parts])
    steps = np.diff(ticks)
    assert steps.min() > 0.5 * np.median(steps)
    assert len(ticks) == station.statistics.samples
    assert sum(len(part.raw) for part in parts) == station.statistics.packets
    return parts


@pytest.mark.parametrize(
    "limit", [{"rotate_mb": 0.05}, {"rotate_minutes": 0.01, "rotate_mb": 0}], ids=["size", "time"]
)
def test_a_file_that_is_long_enough_is_followed_by_another_and_nothing_is_lost(
    run, tmp_path, limit
):
    async def conversation(station):
        await eventually(lambda: station.recordings.rotations >= 3)

    station = run(conversation, **limit)
    assert len(files(tmp_path)) == 1 + station.recordings.rotations
    parts = require_nothing_lost(station, files(tmp_path))
    names = [part.metadata["session"] for part in parts]
    assert {name["session"] for name in names} == {files(tmp_path)[0].stem}
    assert [name["part"] for name in names] == [str(k + 1) for k in range(len(parts))]


def test_as_fast_as_possible_rotation_loses_nothing_either(run, tmp_path):
    async def conversation(station):
        await eventually(lambda: station.recordings.rotations >= 3)

    station = run(conversation, speed="max", rotate_mb=2)
    assert sum(entry.samples for entry in catalogue(tmp_path / "sessions")) == (
        station.statistics.samples
    )
    assert sum(entry.raw_packets for entry in catalogue(tmp_path / "sessions")) == (
        station.statistics.packets
    )
    assert control.status_of(station)["recording"]["dropped"] == 0


def test_a_file_removed_under_the_recorder_is_followed_by_another_at_once(run, tmp_path):
    async def conversation(station):
        files(tmp_path)[0].unlink()
        gone_s = asyncio.get_running_loop().time()
        await eventually(lambda: station.recordings.resumed == 1)
        print(f"recording again after {asyncio.get_running_loop().time() - gone_s:.2f} s")
        await eventually(lambda: control.status_of(station)["recording"]["samples"] > 100)
        assert control.status_of(station)["recording"]["state"] == "recording"
        assert control.status_of(station)["recording"]["wanted"]

    run(conversation)
    (path,) = files(tmp_path)
    assert open_recording(path).damage == []
    assert open_recording(path).metadata["session"]["part"] == "2"


def test_what_an_operator_stopped_is_not_resumed(run, tmp_path):
    async def conversation(station):
        await station.recordings.stop()
        await asyncio.sleep(0.3)
        with pytest.raises(BadInputError, match="nothing is being recorded"):
            station.mark("too late", {})
        with pytest.raises(BadInputError, match="nothing is being recorded"):
            await station.recordings.stop()

    station = run(conversation, rotate_minutes=0.02)
    assert station.recordings.resumed == 0
    assert control.status_of(station)["recording"]["state"] == "finished"


def test_the_oldest_recordings_give_way_and_nothing_else_does(run, tmp_path):
    folder = tmp_path / "sessions"
    folder.mkdir()
    (folder / "flight.mcap").write_bytes(b"x" * 10**6)
    (folder / "notes.txt").write_text("precious")
    (folder / "2000-01-01T00-00-00-000Z_usb.mcap").write_bytes(b"x" * 10**6)

    async def conversation(station):
        await eventually(lambda: station.recordings.deleted >= 3)

    station = run(conversation, rotate_mb=0.05, keep_mb=0.2)
    names = {path.name for path in folder.iterdir()}
    assert {"flight.mcap", "notes.txt"} <= names
    assert "2000-01-01T00-00-00-000Z_usb.mcap" not in names
    ours = [path for path in files(tmp_path) if path.name != "flight.mcap"]
    assert len(ours) == 2 + station.recordings.rotations - station.recordings.deleted
    assert all(open_recording(path).damage == [] for path in ours)
    told = [event.text for event in station.journal.events if event.kind == "deleted"]
    assert len(told) == station.recordings.deleted


def test_the_oldest_go_first_and_no_more_of_them_than_must(tmp_path):
    """By the time in the name: neither size nor the file's own date decides."""
    names = [f"2026-0{month}-01T00-00-00-000Z_usb.mcap" for month in range(1, 7)]
    for age, name in enumerate(reversed(names)):
        (tmp_path / name).write_bytes(b"x" * (100 + age))
        os.utime(tmp_path / name, (1e9 + age, 1e9 + age))
    assert delete_oldest(tmp_path, 406, set()) == (names[:2], [])
    assert sorted(path.name for path in tmp_path.iterdir()) == names[2:]
    assert delete_oldest(tmp_path, 203, {names[2]}) == (names[3:5], [])
    assert sorted(path.name for path in tmp_path.iterdir()) == [names[2], names[5]]


def test_a_link_that_points_elsewhere_is_never_followed_to_delete(tmp_path):
    folder = tmp_path / "sessions"
    folder.mkdir()
    outside = tmp_path / "2000-01-01T00-00-00-000Z_usb.mcap"
    outside.write_bytes(b"x" * 100)
    os.symlink(outside, folder / outside.name)
    assert delete_oldest(folder, 0, set()) == ([], [])
    assert outside.exists()


def test_what_another_daemon_writes_is_not_deleted_and_holds_nothing_up(tmp_path):
    written, finished = (f"2000-01-01T00-00-0{k}-000Z_usb.mcap" for k in range(2))
    (tmp_path / finished).write_bytes(b"x" * 100)
    with McapRecorder(tmp_path / written, {}, low_space_bytes=0):
        deleted, stuck = delete_oldest(tmp_path, 0, set())
        assert deleted == [finished]
        assert stuck == [f"{written}: is still being written"]
    assert open_recording(tmp_path / written).damage == []
    assert delete_oldest(tmp_path, 0, set()) == ([written], [])


def test_a_recording_that_cannot_be_deleted_is_told_once_and_the_next_ones_go(
    run, tmp_path, monkeypatch
):
    folder = tmp_path / "sessions"
    folder.mkdir()
    held = folder / "2000-01-01T00-00-00-000Z_usb.mcap"
    held.write_bytes(b"x" * 10**6)
    monkeypatch.setattr(recording_manager, "RETAIN_S", 0.1)
    unlink = type(held).unlink

    def refusing(path, **options):
        if path == held:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        unlink(path, **options)

    monkeypatch.setattr(type(held), "unlink", refusing)

    async def conversation(station):
        await eventually(lambda: station.recordings.deleted >= 2)
        assert station.supervisor.restarts == 0

    station = run(conversation, rotate_mb=0.05, keep_mb=0.2)
    assert held.exists()
    told = [event.text for event in station.journal.events if event.kind == "fault"]
    assert told == [f"not deleted, though there is too much: {held.name}: Operation not permitted"]


def test_the_catalogue_tells_finished_torn_and_growing_files_apart(run, tmp_path):
    async def conversation(station):
        station.mark("step 1", {"axis": "roll"})
        (entry,) = await asyncio.to_thread(station.recordings.entries)
        assert entry["state"] == "recording"

    began_s = time.monotonic()
    station = run(conversation)
    lasted_s = time.monotonic() - began_s
    (path,) = files(tmp_path)
    torn = path.with_name("torn.mcap")
    torn.write_bytes(path.read_bytes()[:-100])
    os.mkfifo(path.with_name("pipe.mcap"))
    whole, cut = catalogue(tmp_path / "sessions")
    assert (cut.state, cut.samples) == ("torn", None)
    recording = open_recording(path, raw=True)
    assert (whole.state, whole.link, whole.marks, whole.part) == ("finished", "stand-in", 1, 1)
    assert (whole.samples, whole.raw_packets) == (len(recording.samples), len(recording.raw))
    span_s = np.ptp(recording.samples.host_time_ns) * 1e-9
    assert span_s - 0.001 <= whole.duration_s <= lasted_s
    assert station.statistics.samples == whole.samples


def test_a_file_being_made_when_the_daemon_ends_leaves_nothing_behind(run, tmp_path, monkeypatch):
    import threading

    from groundstation.service.recording_manager import Sessions

    create, making, go_on = Sessions.create, threading.Event(), threading.Event()

    def slow(self, link, *, continues=False):
        if continues:
            making.set()
            go_on.wait(30)
        return create(self, link, continues=continues)

    monkeypatch.setattr(Sessions, "create", slow)

    async def conversation(station):
        await eventually(making.is_set)
        station.stop()
        asyncio.get_running_loop().call_later(0.3, go_on.set)

    run(conversation, rotate_minutes=0.01)
    (path,) = files(tmp_path)
    assert open_recording(path).damage == []
