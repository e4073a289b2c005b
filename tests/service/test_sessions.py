import asyncio
import threading

import pytest

from groundstation.errors import BadInputError
from groundstation.links.command import LinkEvent
from groundstation.recording.formats import open_recording
from groundstation.service.recording_manager import Sessions
from groundstation.telemetry.decoder import Decoder, LinkMeter
from support.packets import COPIES, assert_same_samples, flight

METADATA = {"vehicle": {"profile": "crazyflie1"}, "configuration": {"speed": "1.0"}}


@pytest.fixture
def faults():
    return []


@pytest.fixture
def sessions(tmp_path, faults):
    made = Sessions(tmp_path / "sessions", METADATA, low_space_bytes=0, on_fault=faults.append)
    yield made
    made.wait()


def start(sessions, link="stand-in"):
    sessions.require_idle()
    sessions.detach()
    return sessions.install(sessions.create(link))


def stop(sessions):
    return sessions.finish(sessions.detach())


def test_a_file_is_named_after_the_time_and_the_kind_of_link(sessions):
    path = start(sessions, "replay:/some/where/flight.mcap")
    assert path.parent == sessions.folder
    assert path.name.endswith("Z_replay.mcap")


def test_recordings_of_the_same_second_do_not_collide(sessions):
    paths = []
    for _ in range(3):
        paths.append(start(sessions))
        stop(sessions)
    assert len(set(paths)) == 3
    assert all(open_recording(path).damage == [] for path in paths)


def test_everything_goes_into_the_file_of_the_moment(sessions):
    raw, samples = flight(0, 100)
    sessions.samples(samples)  # nothing is recorded yet: dropped on purpose
    path = start(sessions)
    sessions.raw(raw)
    sessions.samples(samples)
    sessions.note(LinkEvent(5, "stand-in", "silent", "nothing", {"for_s": 2}))
    statistics = LinkMeter(0).close_window(6, Decoder().counts())
    sessions.note(statistics)
    sessions.command({"time_ns": 7, "thrust": 1})
    status = stop(sessions)
    sessions.samples(samples)
    assert (status.samples, status.raw_packets, status.dropped) == (100, 100 * COPIES, 0)
    recording = open_recording(path, raw=True)
    assert_same_samples(recording.samples, samples)
    assert recording.events[0]["details"] == {"for_s": 2}
    assert recording.statistics == [statistics.as_dict()]
    assert recording.commands == [{"time_ns": 7, "thrust": 1}]
    assert recording.metadata["session"]["link"] == "stand-in"
    assert {name: recording.metadata[name] for name in METADATA} == METADATA


def test_status_tells_of_the_present_recording_then_of_the_last(sessions):
    assert sessions.status() == {
        "state": "off", "file": None, "bytes": 0, "samples": 0, "dropped": 0,
    }  # fmt: skip
    path = start(sessions)
    assert sessions.status()["state"] == "recording"
    assert sessions.status()["file"] == str(path)
    sessions.samples(flight(0, 10)[1])
    stop(sessions)
    assert sessions.status()["state"] == "finished"
    assert sessions.status()["samples"] == 10
    assert sessions.status()["file"] == str(path)


def test_starting_twice_is_refused_and_the_recording_goes_on(sessions):
    path = start(sessions)
    with pytest.raises(BadInputError, match=f"already recording to {path}"):
        start(sessions)
    sessions.samples(flight(0, 10)[1])
    assert stop(sessions).samples == 10


def test_stopping_nothing_is_refused_to_an_operator(sessions):
    with pytest.raises(BadInputError, match="nothing is being recorded"):
        sessions.require_started()


def test_what_comes_while_a_recording_is_being_finished_is_not_counted_as_lost(sessions):
    raw, samples = flight(0, 5)
    for _ in range(5):
        start(sessions)
        stopping = threading.Thread(target=stop, args=[sessions])
        stopping.start()
        while stopping.is_alive():
            sessions.raw(raw)
            sessions.samples(samples)
        assert sessions.status()["dropped"] <= 5 * (COPIES + 1)  # one batch may be on its way


async def test_a_recording_that_failed_is_told_and_another_can_be_started(sessions, faults):
    path = start(sessions)
    path.unlink()

    async with asyncio.timeout(30):
        while not faults:
            await asyncio.sleep(0.01)
    assert faults == [f"{path}: recording stopped: the file was removed"]
    assert sessions.faults == {path: faults[0]}
    again = start(sessions)
    sessions.samples(flight(0, 10)[1])
    assert stop(sessions).state == "finished"
    assert len(open_recording(again).samples) == 10
    assert sessions.faults == {path: faults[0]}
