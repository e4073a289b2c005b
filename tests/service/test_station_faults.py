"""What must hold whatever else fails: the recording, the answer, the truth of the status."""

import asyncio
import os
import threading
import time

import numpy as np
import pytest

from groundstation.errors import BadInputError, GroundStationError, LinkEndedError, LinkLostError
from groundstation.links.base import Link, LinkState
from groundstation.recording.formats import open_recording
from groundstation.service import control
from groundstation.service import craft_links as receiver_module
from groundstation.service import station as station_module
from groundstation.service.client import TIMEOUT_S, ask
from groundstation.service.config import (
    Config,
    ControlSocket,
    RecordingConfig,
    ViewerConfig,
    socket_path,
)
from groundstation.service.control import ControlServer
from groundstation.service.station import Station
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch
from support.packets import COPIES, flight
from support.waiting import eventually
from support.worlds import station_on


class FedLink(Link):
    """Delivers what a test puts into it; an exception is raised, None is the end."""

    silence_s = 0.02

    def __init__(self):
        super().__init__("fed")
        self.queue = asyncio.Queue()
        self.present = asyncio.Event()
        self.present.set()

    async def _open(self):
        await self.present.wait()

    async def _read(self):
        step = await self.queue.get()
        if step is None:
            raise LinkEndedError("no more")
        if isinstance(step, Exception):
            raise step
        return step

    async def _close(self):
        pass


@pytest.fixture
def live(tmp_path, monkeypatch):
    """Runs a conversation with a recording station on a fed link; the station."""
    monkeypatch.setattr(receiver_module, "RETRY_FIRST_S", 0.001)

    def living(conversation, *, end=True):
        async def session():
            station = station_on("stand-in", tmp_path / "sessions")
            link = FedLink()
            link.on_event, link.clock = station.journal.take, station.clock
            station.receiver.link = link
            running = asyncio.create_task(station.run())
            await eventually(lambda: link.state is LinkState.OPENING)
            try:
                await conversation(station, link)
            finally:
                if end:
                    link.queue.put_nowait(None)
                else:
                    station.stop()
                await running
            return station

        return asyncio.run(session())

    return living


async def test_a_recording_begun_before_the_craft_is_there_goes_on_when_it_appears(tmp_path):
    station = station_on("stand-in", tmp_path / "sessions")
    link = FedLink()
    link.on_event, link.clock = station.journal.take, station.clock
    link.present.clear()
    station.receiver.link = link
    running = asyncio.create_task(station.run())
    await eventually(lambda: link.state is LinkState.OPENING)
    path = await station.recordings.start()
    link.present.set()
    link.queue.put_nowait(flight(0, 100)[1])
    link.queue.put_nowait(None)
    await running  # does not fail
    assert list(path.parent.iterdir()) == [path]
    assert len(open_recording(path).samples) == 100


def pieces(raw, size=37):
    return [
        RawBatch(raw.packets[at : at + size], raw.host_time_ns[at : at + size])
        for at in range(0, len(raw), size)
    ]


def files(tmp_path):
    return sorted((tmp_path / "sessions").glob("*.mcap"))


def test_stopping_and_starting_at_the_same_time_loses_no_recording(live, tmp_path):
    async def conversation(station, link):
        await eventually(lambda: station.sessions.status()["state"] == "recording")
        for _ in range(5):
            async with asyncio.TaskGroup() as both:
                both.create_task(station.recordings.stop())
                both.create_task(station.recordings.start())

    station = live(conversation)
    assert len(files(tmp_path)) == 6
    assert [open_recording(path).damage for path in files(tmp_path)] == [[]] * 6
    assert station.sessions.status()["state"] == "finished"


def test_two_who_stop_at_once_finish_one_recording(live, tmp_path):
    async def conversation(station, link):
        await eventually(lambda: station.sessions.status()["state"] == "recording")
        done = await asyncio.gather(
            station.recordings.stop(), station.recordings.stop(), return_exceptions=True
        )
        assert done[0]["state"] == "finished"
        assert isinstance(done[1], BadInputError)

    live(conversation)
    assert len(files(tmp_path)) == 1


def test_the_samples_of_a_files_packets_are_in_that_file(live, tmp_path):
    """A sample waits 6 ms for its turn: it must not turn up in the next file."""
    raw, _ = flight(0, 100)
    middle = 50 * COPIES

    async def conversation(station, link):
        for part in pieces(RawBatch(raw.packets[:middle], raw.host_time_ns[:middle])):
            link.queue.put_nowait(part)
        await eventually(lambda: station.receiver.decoder.counts().packets == middle)
        await station.recordings.stop()
        await station.recordings.start()
        for part in pieces(RawBatch(raw.packets[middle:], raw.host_time_ns[middle:])):
            link.queue.put_nowait(part)

    live(conversation)
    for path in files(tmp_path):
        recording = open_recording(path, raw=True)
        again, _ = decode_all(recording.raw, start_ticks=int(recording.samples.ticks[0]))
        np.testing.assert_array_equal(recording.samples.ticks, again.ticks)
        assert len(again) == 50


def test_while_the_device_is_away_windows_close_and_the_status_says_lost(
    live, tmp_path, monkeypatch
):
    monkeypatch.setattr(station_module, "STATISTICS_S", 0.02)

    async def conversation(station, link):
        link.queue.put_nowait(flight(0, 200)[0])
        await eventually(lambda: station.statistics and station.statistics.samples)
        link.present.clear()
        link.queue.put_nowait(LinkLostError("unplugged"))
        await eventually(lambda: control.status_of(station)["link"]["state"] == "lost")
        before = station.statistics
        await eventually(
            lambda: station.statistics is not before and station.statistics.rate_hz == 0
        )
        silent = station.statistics
        await eventually(lambda: station.statistics is not silent)
        status = control.status_of(station)["link"]
        assert (status["state"], status["rate_hz"], status["latency_ms"]) == ("lost", 0.0, None)
        link.present.set()
        link.queue.put_nowait(flight(1000, 50)[0])
        await eventually(lambda: control.status_of(station)["link"]["state"] == "streaming")

    live(conversation)
    recorded = open_recording(files(tmp_path)[0]).statistics
    assert sum(entry["rate_hz"] == 0 for entry in recorded) >= 2


@pytest.mark.parametrize("broken", ["link", "decoder"])
def test_the_recording_is_finished_whatever_else_fails_at_the_end(
    live, tmp_path, monkeypatch, broken
):
    async def conversation(station, link):
        async def fail():
            raise RuntimeError("broken on purpose")

        def fail_at_once():
            raise RuntimeError("broken on purpose")

        link.queue.put_nowait(flight(0, 50)[0])
        await eventually(lambda: station.receiver.decoder.counts().packets)
        if broken == "link":
            monkeypatch.setattr(link, "_close", fail)
        else:
            monkeypatch.setattr(station.receiver.decoder, "finish", fail_at_once)

    with pytest.raises(RuntimeError, match="on purpose"):
        live(conversation, end=False)
    (path,) = files(tmp_path)
    recording = open_recording(path, raw=True)
    assert recording.damage == []
    assert len(recording.raw) == 50 * COPIES


def test_statistics_are_on_the_time_base_of_the_packets(live, tmp_path):
    """The packets of a fast replay are stamped ahead of the clock."""
    raw, _ = flight(0, 100)

    async def conversation(station, link):
        ahead = station.clock() + 3_600_000_000_000
        shifted = RawBatch(raw.packets, raw.host_time_ns - raw.host_time_ns[0] + ahead)
        link.queue.put_nowait(shifted)
        await eventually(lambda: station.receiver.decoder.counts().packets)

    live(conversation)
    recording = open_recording(files(tmp_path)[0])
    assert recording.statistics[-1]["time_ns"] >= recording.samples.host_time_ns[-1]


async def test_a_fault_of_the_daemon_is_an_answer_an_event_and_a_count(tmp_path):
    station = Station(Config(recording=RecordingConfig(folder=str(tmp_path / "s"))))
    control = ControlSocket(tmp_path / "control.sock")
    server = ControlServer(station, control)
    await server.start()
    station.recordings.status = lambda: 1 / 0
    try:
        with pytest.raises(GroundStationError) as told:
            await asyncio.to_thread(ask, control.path, "GET", "/status")
    finally:
        await server.stop()
        control.close()
    told = str(told.value)
    assert "GET /status: internal fault: ZeroDivisionError" in told
    assert station.journal.faults == 1
    assert station.journal.events[-1].kind == "fault"


def test_a_daemon_that_does_not_answer_is_told_with_what_to_do(tmp_path, monkeypatch):
    from groundstation.recording.mcap_file import _FINISH_TIMEOUT_S
    from groundstation.service import client

    assert TIMEOUT_S > _FINISH_TIMEOUT_S
    monkeypatch.setattr(client, "TIMEOUT_S", 0.05)
    control = ControlSocket(tmp_path / "control.sock")
    with pytest.raises(GroundStationError, match=r"has not answered .* start it again"):
        ask(control.path, "GET", "/status")
    control.close()


@pytest.fixture
def shared(tmp_path, monkeypatch):
    """Where the socket is on a system without runtime folders."""
    monkeypatch.delenv("GROUNDSTATION_SOCKET", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return socket_path()


@pytest.mark.parametrize("mode", [0o755, 0o777])
def test_a_folder_in_reach_of_others_is_refused(shared, mode):
    ControlSocket(shared).close()
    os.chmod(shared.parent, mode)
    with pytest.raises(GroundStationError, match="not a folder of yours alone"):
        ControlSocket(shared)


def test_a_link_in_place_of_the_folder_is_refused(shared, tmp_path):
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    shared.parent.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(GroundStationError, match="not a folder of yours alone"):
        ControlSocket(shared)


def test_settings_without_sense_are_refused_by_key():
    with pytest.raises(BadInputError, match=r"setting vehicle: .*banana"):
        Station(Config(vehicle="banana"))
    with pytest.raises(BadInputError, match=r"viewer\.port and viewer\.web_port: both are 9090"):
        Station(Config(viewer=ViewerConfig(mode="serve", port=9090, web_port=9090)))


def test_work_in_the_background_does_not_hold_up_the_end():
    from groundstation.background import in_background, left_behind

    hold = threading.Event()

    async def impatient():
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.01):
                await in_background(lambda: hold.wait(60))

    asyncio.run(impatient())  # would wait for the thread of an executor
    assert left_behind()
    hold.set()
    assert asyncio.run(in_background(lambda: 7)) == 7
    with pytest.raises(ZeroDivisionError):
        asyncio.run(in_background(lambda: 1 / 0))


async def test_a_link_that_is_lost_and_returns_a_hundred_times_costs_nothing_each_time(
    tmp_path, monkeypatch
):
    """A real serial line, closed and opened anew: descriptors, threads and memory stay."""
    import psutil

    from firmware_sim.craft import StandIn
    from firmware_sim.serial_port import SerialPort
    from firmware_sim.settings import Loss, StandInSettings

    monkeypatch.setattr(receiver_module, "RETRY_FIRST_S", 0.01)
    monkeypatch.setattr(receiver_module, "RETRY_MOST_S", 0.02)
    name, cycles = tmp_path / "craft", 100
    craft = StandIn(StandInSettings(loss=Loss(good_loss=0.0)))
    used = []

    station = station_on(f"serial:{name}", tmp_path / "sessions")
    running = asyncio.create_task(station.run())
    process, began_s = psutil.Process(), time.monotonic()
    reached = LinkState.OPENING, LinkState.STREAMING
    for cycle in range(cycles):
        with SerialPort(f"pty:{name}") as port:
            await eventually(lambda: station.receiver.link.state in reached)
            wanted = station.receiver.decoder.counts().samples + 20
            while station.receiver.decoder.counts().samples < wanted:
                port.send(craft.advance(time.monotonic() - began_s)[0])
                assert not running.done(), running
                await asyncio.sleep(0.002)
        await eventually(lambda: station.receiver.state in (LinkState.LOST, LinkState.OPENING))
        if cycle in (cycles // 5, cycles - 1):
            memory = process.memory_info().rss / 1e6
            used.append((process.num_fds(), process.num_threads(), memory))
    station.stop()
    await running
    (path,) = files(tmp_path)
    recording = open_recording(path)
    assert recording.damage == []
    assert len(np.unique(recording.samples.segment)) == cycles
    lost = [event for event in recording.events if event["kind"] == "lost"]
    assert len(lost) == cycles
    (early, late) = used
    print(f"{cycles} losses: descriptors {early[0]} -> {late[0]}, threads {early[1]} -> {late[1]}, "
          f"memory {late[2] - early[2]:+.1f} MB")  # fmt: skip
    assert late[0] <= early[0] + 1
    assert late[1] <= early[1] + 1
    assert late[2] - early[2] < 10
    assert station.journal.faults == 0
