"""The station with links that come and go, inside this process."""

import asyncio

import numpy as np
import pytest

from groundstation.errors import BadInputError, LinkEndedError, LinkError, LinkLostError
from groundstation.links.base import Link
from groundstation.page.app import alarms
from groundstation.recording.formats import open_recording
from groundstation.service import control
from groundstation.service import craft_links as receiver_module
from groundstation.service.client import ask
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from groundstation.service.craft_links import EVENTS_KEPT
from groundstation.telemetry.samples import RawBatch
from support.packets import COPIES, flight
from support.waiting import until
from support.worlds import serve, station_on


class ScriptedLink(Link):
    """A device as its script wants it: batches, exceptions, and seconds of silence."""

    def __init__(self, script, *, refuse=()):
        super().__init__("scripted")
        self.silence_s = 0.02
        self.opened = self.closed = 0
        self._script = iter(script)
        self._refuse = iter(refuse)

    async def _open(self):
        self.opened += 1
        error = next(self._refuse, None)
        if error is not None:
            raise error

    async def _read(self):
        await asyncio.sleep(0)
        step = next(self._script, None)
        if step is None:
            raise LinkEndedError("the end of the script")
        if isinstance(step, Exception):
            raise step
        if isinstance(step, float):
            await asyncio.sleep(step)
            return await self._read()
        return step

    async def _close(self):
        self.closed += 1


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs a station on a link until the link ends: the station and its recording."""
    monkeypatch.setattr(receiver_module, "RETRY_FIRST_S", 0.001)
    monkeypatch.setattr(receiver_module, "RETRY_MOST_S", 0.002)

    def running(link, *, enabled=True):
        async def session():
            station = station_on("stand-in", tmp_path / "sessions", enabled)
            link.on_event, link.station = station.journal.take, station
            station.receiver.link = link
            link.clock = station.clock
            async with asyncio.timeout(30):
                await station.run()
            return station

        station = asyncio.run(session())
        file = station.sessions.status()["file"]
        return station, open_recording(file, raw=True) if file else None

    return running


def later(batch, seconds):
    return RawBatch(batch.packets, batch.host_time_ns + int(seconds * 1e9))


def kinds(station, link):
    return [event.kind for event in station.journal.events if event.link == link]


def test_what_comes_in_is_decoded_recorded_and_counted(run):
    raw, samples = flight(0, 200)
    cuts = [RawBatch(raw.packets[at : at + 37], raw.host_time_ns[at : at + 37])
            for at in range(0, 800, 37)]  # fmt: skip
    station, recording = run(ScriptedLink(cuts))
    np.testing.assert_array_equal(recording.raw.packets, raw.packets)
    np.testing.assert_array_equal(recording.samples.ticks, samples.ticks)
    np.testing.assert_array_equal(recording.samples.copies, COPIES)
    assert station.statistics.samples == 200
    assert recording.statistics[-1]["samples"] == 200
    assert kinds(station, "scripted") == ["opening", "streaming", "ended", "closed"]
    recorded = [event["kind"] for event in recording.events]
    assert recorded == ["recording", "streaming", "ended", "closed"]


def test_a_device_that_is_lost_is_opened_again_and_starts_a_new_segment(run):
    first, _ = flight(0, 100)
    second, _ = flight(1000, 100)
    link = ScriptedLink([first, LinkLostError("unplugged"), later(second, 0.0)])
    station, recording = run(link)
    assert (link.opened, link.closed) == (2, 2)
    assert recording.samples.segment.tolist() == [0] * 100 + [1] * 100
    assert len(recording.raw) == 200 * COPIES
    assert kinds(station, "scripted") == [
        "opening", "streaming", "lost", "closed", "opening", "streaming", "ended", "closed",
    ]  # fmt: skip
    assert "unplugged" in [event["text"] for event in recording.events]


def test_a_device_that_is_absent_at_first_is_waited_for_and_told_of(run):
    raw, _ = flight(0, 50)
    absent = [LinkError("no device 0483:5741")] * 3
    link = ScriptedLink([raw], refuse=[*absent, LinkError("permission denied")])
    station, recording = run(link)
    assert link.opened == 5
    assert len(recording.samples) == 50
    waiting = [event.text for event in station.journal.events if event.kind == "waiting"]
    assert waiting == ["no device 0483:5741", "permission denied"]


def test_waiting_for_a_device_does_not_fill_the_log(run):
    raw, _ = flight(0, 50)
    absent = [LinkError("no device 0483:5741")] * 50
    script = [raw, LinkLostError("unplugged"), later(raw, 1.0)]
    station, _ = run(ScriptedLink(script, refuse=[None, *absent]))
    assert kinds(station, "scripted") == [
        "opening", "streaming", "lost", "closed", "opening", "closed", "waiting",
        "streaming", "ended", "closed",
    ]  # fmt: skip


def test_the_status_says_lost_until_the_device_is_back(run):
    raw, _ = flight(0, 50)
    states = []

    class WatchedLink(ScriptedLink):
        async def _open(self):
            states.append(control.status_of(self.station)["link"]["state"])
            await super()._open()

    link = WatchedLink(
        [raw, LinkLostError("unplugged"), later(raw, 1.0)],
        refuse=[LinkError("absent"), None, LinkError("absent"), LinkError("absent")],
    )
    run(link)
    assert states == ["opening", "opening", "lost", "lost", "lost"]


def test_a_link_that_can_never_work_ends_the_station_and_leaves_no_file(run, tmp_path):
    with pytest.raises(BadInputError, match="no such port"):
        run(ScriptedLink([], refuse=[BadInputError("no such port")]))
    assert not (tmp_path / "sessions").exists()


def test_a_link_that_once_worked_is_waited_for_whatever_opening_it_says(run):
    """A port may go in the very moment in which it is opened, and look like no port at all."""
    first, _ = flight(0, 50)
    second, _ = flight(1000, 50)
    script = [first, LinkLostError("unplugged"), later(second, 0.0)]
    link = ScriptedLink(script, refuse=[None, BadInputError("is no serial port")])
    station, recording = run(link)
    assert recording.samples.segment.tolist() == [0] * 50 + [1] * 50
    waiting = [event.text for event in station.journal.events if event.kind == "waiting"]
    assert waiting == ["is no serial port"]


def test_a_fault_of_the_link_is_survived_counted_and_told(run):
    first, _ = flight(0, 50)
    second, _ = flight(1000, 50)
    link = ScriptedLink([first, ZeroDivisionError("in the reader"), later(second, 0.0)])
    station, recording = run(link)
    assert link.opened == 2
    assert station.journal.faults == control.status_of(station)["faults"] == 1
    assert recording.samples.segment.tolist() == [0] * 50 + [1] * 50
    (told,) = [event.text for event in station.journal.events if event.kind == "fault"]
    assert "in the reader" in told


def test_a_failed_read_is_a_new_segment_too(run):
    first, _ = flight(0, 50)
    second, _ = flight(1000, 50)
    script = [first, LinkError("the port answers no more"), later(second, 0.0)]
    _, recording = run(ScriptedLink(script))
    assert recording.samples.segment.tolist() == [0] * 50 + [1] * 50


def test_a_fault_in_a_replay_ends_it_for_opened_again_it_would_begin_anew(run, tmp_path):
    raw, _ = flight(0, 50)
    link = ScriptedLink([raw, ZeroDivisionError()])
    link.finite = True
    with pytest.raises(LinkError, match="reading failed in the middle"):
        run(link)
    (path,) = (tmp_path / "sessions").glob("*.mcap")
    recording = open_recording(path)
    assert recording.damage == []
    assert len(recording.samples) == 50


def test_a_silence_is_told_and_costs_nothing(run):
    first, _ = flight(0, 50)
    second, _ = flight(100, 50)
    station, recording = run(ScriptedLink([first, 0.1, second]))
    assert kinds(station, "scripted") == [
        "opening", "streaming", "silent", "streaming", "ended", "closed",
    ]  # fmt: skip
    assert len(recording.samples) == 100
    assert set(recording.samples.segment) == {0}


def test_a_restart_of_the_device_is_an_event(run):
    first, _ = flight(0, 100)
    second, _ = flight(5, 100)
    station, recording = run(ScriptedLink([first, later(second, 3.0005)]))
    assert set(recording.samples.segment) == {0, 1}
    assert kinds(station, "scripted").count("restart") == 1


def test_recording_can_be_off(run):
    station, recording = run(ScriptedLink([flight(0, 50)[0]]), enabled=False)
    assert recording is None
    assert station.statistics.samples == 50


def test_old_events_are_forgotten_not_hoarded(run):
    raw, _ = flight(0, 5)
    script = [step for _ in range(1200) for step in (raw, LinkLostError("flapping"))]
    station, _ = run(ScriptedLink(script), enabled=False)
    assert len(station.journal.events) == EVENTS_KEPT
    assert station.journal.events[-1].kind == "closed"


def test_a_stand_in_whose_battery_is_changed_says_so_and_is_no_alarm(tmp_path):
    config = Config(
        link=LinkConfig(speed=10.0),
        recording=RecordingConfig(folder=str(tmp_path), enabled=False),
        stand_in={"charge": 0.12, "recharge_s": 60.0, "program": "hover"},
    )
    control = tmp_path / "control.sock"

    def conversation(station):
        seen = []

        def back():
            seen.append(ask(control, "GET", "/status"))
            return seen[-1]["link"]["doing"] == "it flies, with battery 2"

        until(back, "the second battery", every_s=0.1)
        pausing = [one for one in seen if one["link"]["pauses"]]
        assert any(one["link"]["state"] == "silent" for one in pausing)
        for one in pausing:
            assert "its battery is changed" in one["link"]["doing"]
            assert {told["level"] for told in alarms(one, "", 3.0)} == {"warning"}

    serve(config, control, conversation)
