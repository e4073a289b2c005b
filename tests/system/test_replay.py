"""A recording, replayed into the daemon and recorded again, is the same recording."""

import numpy as np
import pytest

from groundstation.recording.formats import open_recording
from groundstation.recording.quality import inspect_recording
from groundstation.telemetry.samples import COLUMNS
from support import RECORDINGS
from support.daemons import Daemon
from support.packets import write_flight

FLIGHT = RECORDINGS / "stand_in_flight.mcap"
EXCERPT = RECORDINGS / "thesis_excerpt.csv"
MICROSD = RECORDINGS / "microsd_log16"


def recorded_again(folder, source, *arguments):
    with Daemon(folder, "--link", f"replay:{source}", *arguments) as daemon:
        assert daemon.wait() == 0
        return daemon.only_file()


def require_same(again, source):
    """Packet by packet and sample by sample; host stamps moved by one constant."""
    shift = again.samples.host_time_ns[0] - source.samples.host_time_ns[0]
    if source.raw is not None and len(source.raw):
        np.testing.assert_array_equal(again.raw.packets, source.raw.packets)
        np.testing.assert_array_equal(again.raw.host_time_ns - shift, source.raw.host_time_ns)
    assert again.samples.tick_s == source.samples.tick_s
    for name in COLUMNS:
        got, expected = getattr(again.samples, name), getattr(source.samples, name)
        if name == "host_time_ns":
            got = got - shift
        np.testing.assert_array_equal(got, expected, err_msg=name)


@pytest.mark.parametrize(
    ("source", "arguments"),
    [
        (FLIGHT, ("--speed", "max")),
        (EXCERPT, ()),
        (RECORDINGS / "thesis_excerpt.mcap", ("--speed", "0.1")),
        (MICROSD, ("--speed", "max")),
    ],
)
def test_a_replay_that_is_recorded_again_is_identical(tmp_path, source, arguments):
    again = open_recording(recorded_again(tmp_path, source, *arguments), raw=True)
    require_same(again, open_recording(source, raw=True))
    assert again.metadata["session"]["link"] == f"replay:{source}"


def test_a_flight_with_silences_restarts_and_a_bad_radio_is_identical_after_two_replays(tmp_path):
    """A fresh battery: the craft is silent for two seconds and starts anew."""
    (tmp_path / "config.toml").write_text(
        "[link]\nspeed = 'max'\n"
        "[stand_in]\nseed = 3\ncharge = 0.03\nrecharge_s = 2.0\n"
        "loss = {good_loss = 0.2, bad_loss = 0.95, to_bad = 0.002, to_good = 0.01}\n"
    )
    with Daemon(tmp_path / "flown", "--config", tmp_path / "config.toml") as daemon:
        daemon.recording(samples=8_000)
        assert daemon.stop() == 0
        flown = daemon.only_file()
    first = recorded_again(tmp_path / "first", flown, "--speed", "max")
    second = recorded_again(tmp_path / "second", first, "--speed", "max")
    original = open_recording(flown, raw=True)
    require_same(open_recording(first, raw=True), original)
    require_same(open_recording(second, raw=True), original)
    assert original.samples.segment[-1] >= 1, "the flight did not restart"
    assert inspect_recording(original)["lost_samples"] > 0, "the radio was too good"


def test_a_torn_recording_is_replayed_as_far_as_it_is_good_and_that_is_an_error(tmp_path):
    torn = tmp_path / "torn.mcap"
    write_flight(torn, 500, chunk_rows=100)
    torn.write_bytes(torn.read_bytes()[: torn.stat().st_size * 3 // 5])
    with Daemon(tmp_path, "--link", f"replay:{torn}", "--speed", "max") as daemon:
        assert daemon.wait() == 1
        assert daemon.last_line.startswith("groundstation: ")
        assert str(torn) in daemon.last_line
        assert "is damaged; what could be read was delivered" in daemon.last_line
        assert daemon.stderr.count("groundstation: ") == 1
        require_same(open_recording(daemon.only_file(), raw=True), open_recording(torn, raw=True))
