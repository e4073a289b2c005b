"""Recordings folders that nobody may look into, with names too long, with flipped bits."""

import asyncio
import os
import random

import numpy as np
import pytest

from groundstation.cli.run import _require_something
from groundstation.errors import BadInputError, GroundStationError, RecordingError
from groundstation.recording.mcap_file import McapRecorder
from groundstation.recording.mcap_scan import catalogue, recover
from groundstation.service.client import ask
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from groundstation.service.station import Station
from groundstation.telemetry.packet import TICK_S
from groundstation.telemetry.samples import empty_samples
from support import RECORDINGS
from support.daemons import groundstation
from support.worlds import serve

pytestmark = pytest.mark.timeout(60)


@pytest.fixture
def recorded(tmp_path):
    """A folder with one finished recording."""
    samples = empty_samples(200, TICK_S)
    samples.host_time_ns[:] = 1_700_000_000_000_000_000 + np.arange(200) * 2_000_000
    metadata = {"session": {"link": "serial:/dev/ttyACM0", "session": "s", "part": "1"}}
    with McapRecorder(tmp_path / "one.mcap", metadata, low_space_bytes=0) as recorder:
        recorder.samples(samples)
    return tmp_path


@pytest.fixture
def nobody():
    """Another user, to whom a folder of pytest's is closed."""
    if os.geteuid() != 0:
        pytest.skip("becoming another user needs root")
    os.seteuid(65534)
    yield
    os.seteuid(0)


def test_no_flipped_bit_hides_a_folder(recorded):
    (whole,) = catalogue(recorded)
    assert (whole.state, whole.samples, whole.link) == ("finished", 200, "serial:/dev/ttyACM0")
    good = (recorded / "one.mcap").read_bytes()
    draw = random.Random(20)
    states = set()
    for n in range(400):
        bad = bytearray(good)
        at = draw.randrange(len(bad)) if n % 2 else len(bad) - 1 - draw.randrange(300)
        bad[at] ^= 1 << draw.randrange(8)
        (recorded / "one.mcap").write_bytes(bad)
        (entry,) = catalogue(recorded)
        states.add(entry.state)
        assert entry.state == "damaged" or entry == whole
    assert states == {"finished", "damaged"}
    (recorded / "two.mcap").write_bytes(good)
    (recorded / "one.mcap").write_bytes(good[:-20] + b"\xff" * 12 + good[-8:])
    assert [entry.state for entry in catalogue(recorded)] == ["damaged", "finished"]
    listed = groundstation("inspect", recorded)
    assert listed.returncode == 0, listed.stderr
    assert "damaged; see 'groundstation recover'" in listed.stdout


def test_a_file_that_another_daemon_writes_is_recording_not_torn(tmp_path):
    with McapRecorder(tmp_path / "live.mcap", {}, low_space_bytes=0):
        (entry,) = catalogue(tmp_path)
        with pytest.raises(BadInputError, match="still being written"):
            recover(tmp_path / "live.mcap")
    assert entry.state == "recording"


def test_a_folder_that_may_not_be_searched_is_words(tmp_path, nobody):
    with pytest.raises(RecordingError, match="Permission denied"):
        catalogue(tmp_path / "sessions")


def test_a_run_that_cannot_record_ends_with_one_line(tmp_path):
    folder = tmp_path / ("x" * 300)
    result = groundstation(
        "run", "--link", f"replay:{RECORDINGS / 'thesis_excerpt.csv'}", "--recordings", folder,
        cwd=tmp_path, socket_path=tmp_path / "c.sock",
    )  # fmt: skip
    assert result.returncode == 1
    assert "File name too long" in result.stderr.strip().splitlines()[-1]
    assert "Traceback" not in result.stderr


def test_a_folder_that_fails_at_run_time_is_words(tmp_path):
    folder = str(tmp_path / ("x" * 300))
    path = tmp_path / "c.sock"
    config = Config(
        link=LinkConfig(name="serial:/dev/nope"),
        recording=RecordingConfig(folder=folder, enabled=False),
    )

    def conversation(station):
        for method, route in (("POST", "/record/start"), ("GET", "/recordings")):
            with pytest.raises(GroundStationError, match="File name too long") as refusal:
                ask(path, method, route)
            assert "internal fault" not in str(refusal.value)
        return station.journal.faults

    assert serve(config, path, conversation) == 0


@pytest.mark.parametrize(
    "arguments",
    [["--link", "serial:/dev/nope"], ["--link", "usb"]],
    ids=["a port that is not there", "a bridge that is not plugged in"],
)
def test_a_run_that_received_nothing_because_of_a_fault_has_failed(tmp_path, arguments):
    result = groundstation(
        "run", *arguments, "--for", "0.3", cwd=tmp_path, socket_path=tmp_path / "c.sock"
    )
    assert result.returncode == 1, result.stderr
    assert result.stderr.strip().splitlines()[-1].startswith("groundstation: nothing was received")


def test_a_command_link_that_could_never_connect_is_a_failure_too(tmp_path):
    config = Config(
        command="radio://0/80/2M", recording=RecordingConfig(folder=str(tmp_path), enabled=False)
    )
    station = Station(config)
    station._take_samples(empty_samples(1, TICK_S))
    _require_something(station)  # nothing was told yet
    station.craft.tell_no_craft()
    with pytest.raises(GroundStationError, match=r"never connected.*another craft"):
        _require_something(station)


def test_a_fault_that_repeats_under_other_file_names_is_told_once(tmp_path):
    station = Station(Config(recording=RecordingConfig(folder=str(tmp_path / "sessions"))))

    async def fail_often():
        for _ in range(5):
            station.recordings._retry_at_s = 0.0
            (tmp_path / "sessions").touch()  # a file where the folder should be
            assert await station.recordings._next("recording cannot be resumed") is None
            await asyncio.sleep(0.002)

    asyncio.run(fail_often())
    faults = [event.text for event in station.journal.events if event.kind == "fault"]
    assert len(faults) == 1
