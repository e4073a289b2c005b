"""The fault table of docs/reliability.md: each row is a test that prints its figure (``-s``)."""

import contextlib
import os
import signal
import sys
import time

import numpy as np
import psutil
import pytest

from groundstation.errors import GroundStationError
from groundstation.recording.formats import open_recording
from groundstation.recording.quality import inspect_recording
from groundstation.service.client import ask
from support.commands import software_craft
from support.daemons import Daemon, build_shim, gaps, groundstation, require_failure
from support.programs import Program, run_program
from support.waiting import until

STOPPED_S = 5.0
HOUR_S = 3600


def figure(row, text):
    print(f"\nFIGURE {row}: {text}")


def continuous(recording):
    """Not a sample is missing; the recording."""
    report = inspect_recording(recording)
    assert (report["lost_samples"], report["gap_count"], report["damage"]) == (0, 0, [])
    return recording


def envelope_s(samples):
    """How much earlier than any other the earliest arrival was, host minus device time, s."""
    return (samples.host_time_ns * 1e-9 - samples.time_s).min()


def test_a_daemon_that_is_stopped_for_five_seconds_stamps_right_afterwards(tmp_path):
    name = tmp_path / "craft"
    with (
        software_craft(tmp_path, "[loss]\ngood_loss = 0.0\n", "--serial", f"pty:{name}"),
        Daemon(tmp_path, "--link", f"serial:{name}") as daemon,
    ):
        daemon.recording(samples=1000)
        daemon.process.send_signal(signal.SIGSTOP)
        time.sleep(STOPPED_S)
        daemon.process.send_signal(signal.SIGCONT)
        before = daemon.status()["recording"]["samples"]
        daemon.recording(samples=before + 1500)
        assert daemon.stop() == 0
        recording = open_recording(daemon.only_file())
    samples = recording.samples
    assert recording.damage == []
    gap = int(np.argmax(np.diff(samples.host_time_ns)))
    settled = samples.host_time_ns[gap + 1] + int(0.5e9)
    first = samples[samples.host_time_ns <= samples.host_time_ns[gap]]
    later = samples[samples.host_time_ns > settled]
    if later.segment[0] != first.segment[0]:
        # told, not guessed: what was buffered while it stood still had no right stamps
        assert "restart" in [event["kind"] for event in recording.events]
        figure("daemon stopped 5 s", "a new segment")
        return
    error_s = envelope_s(later) - envelope_s(first)
    figure("daemon stopped 5 s", f"device time {1e3 * error_s:+.1f} ms off afterwards")
    assert abs(error_s) < 0.03, "half a wrap of the device's clock is 33 ms"


@pytest.mark.parametrize("step_s", [HOUR_S, -HOUR_S])
def test_a_wall_clock_that_is_stepped_by_an_hour_changes_nothing(tmp_path, step_s):
    deceived = build_shim(tmp_path / "shim")
    rotate = ("--set", "recording.rotate_minutes=0.03")
    with Daemon(tmp_path, *rotate, environment=deceived.environment) as daemon:
        daemon.recording(samples=500)
        deceived.step_clock(step_s)
        daemon.status_when(lambda s: s["recording"]["rotations"] >= 2, "two rotations")
        assert daemon.status()["link"]["state"] == "streaming"
        assert daemon.stop() == 0
        parts = [open_recording(path) for path in daemon.files()]
    samples = [part.samples for part in parts]
    ticks = np.concatenate([part.ticks for part in samples])
    host_ns = np.concatenate([part.host_time_ns for part in samples])
    assert np.diff(ticks).max() < 1.5 * np.median(np.diff(ticks)), "files are in order, whole"
    drift_s = np.ptp(host_ns * 1e-9 - ticks * samples[0].tick_s)
    figure(f"clock stepped {step_s:+d} s", f"host stamps within {1e3 * drift_s:.0f} ms of even")
    assert drift_s < HOUR_S / 60
    assert {part.metadata["session"]["session"] for part in parts} == {daemon.files()[0].stem}


def test_a_power_loss_costs_only_what_was_not_synced_yet(tmp_path):
    deceived = build_shim(tmp_path / "shim")
    with Daemon(tmp_path, environment=deceived.environment) as daemon:
        daemon.recording(samples=2000)
        path = daemon.only_file()
        syncs = deceived.syncs(path.stat().st_ino)
        assert daemon.stop(signal.SIGKILL) == -signal.SIGKILL
    whole = path.read_bytes()
    host_ns = open_recording(path).samples.host_time_ns
    missing_s = []
    for (_, before_ns), (size, time_ns), (_, next_ns) in zip(
        syncs[1:], syncs[2:], syncs[3:], strict=False
    ):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(whole[:size])  # what a disk may hold when the power goes at next_ns
        kept = open_recording(cut).samples
        np.testing.assert_array_equal(kept.host_time_ns, host_ns[: len(kept)])
        missing_s.append((next_ns - kept.host_time_ns[-1]) * 1e-9)
        assert before_ns <= kept.host_time_ns[-1] <= time_ns, "each takes what came before the last"
    figure("power loss", f"at most the last {max(missing_s):.2f} s, over {len(missing_s)} moments")
    assert len(missing_s) > 5


def test_a_disk_that_fills_up_and_is_freed(small_disk, tmp_path):
    disk = small_disk("40m")
    ballast = disk / "ballast"
    options = ("--recordings", disk, "--set", "recording.low_space_mb=2")
    with Daemon(tmp_path, *options) as daemon:
        daemon.recording(samples=500)
        ballast.write_bytes(b"x" * (os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize - 10**6))
        full = daemon.status_when(lambda s: s["recording"]["state"] == "low_space", "low space")
        assert not full["health"]["healthy"]
        assert full["link"]["state"] == "streaming"
        assert groundstation("status", socket_path=daemon.socket).stdout.count("low_space") >= 1
        ballast.unlink()
        freed_s = time.monotonic()
        daemon.status_when(lambda s: s["recording"]["resumed"] == 1, "recording again")
        figure("disk full and freed", f"recording again {time.monotonic() - freed_s:.1f} s later")
        daemon.recording(samples=300)
        assert daemon.status()["health"]["healthy"]
        assert daemon.stop() == 1, "a session with a hole is no success"
        assert "the disk is almost full" in daemon.last_line
    first, second = (open_recording(path) for path in sorted(disk.glob("*.mcap")))
    for part in (first, second):
        continuous(part)
    assert second.metadata["session"]["part"] == "2"
    assert "low_space" in " ".join(event["text"] for event in second.events)


def test_a_folder_that_becomes_read_only_is_told_and_used_again_afterwards(small_disk, tmp_path):
    disk = small_disk("40m")

    def remount(mode):
        run_program(["mount", "-o", f"remount,{mode}", disk], check=True)

    remount("ro")
    with Daemon(tmp_path / "a", "--recordings", disk) as daemon:
        assert daemon.wait() == 1
        assert "Read-only file system" in daemon.last_line
        assert "Traceback" not in daemon.stderr
    with Daemon(tmp_path / "b", "--recordings", disk, "--no-record") as daemon:
        daemon.status_when(lambda s: s["link"]["rate_hz"] > 0, "telemetry")

        def record():
            return groundstation("record", "start", socket_path=daemon.socket)

        assert "Read-only file system" in require_failure(record())
        assert daemon.status()["link"]["state"] == "streaming"
        remount("rw,size=200m")
        assert record().returncode == 0
        daemon.recording(samples=100)
        assert daemon.stop() == 0
    (path,) = disk.glob("*.mcap")
    continuous(open_recording(path))


def test_many_clients_at_once_for_a_while_leave_the_daemon_as_it_was(tmp_path):
    """Status, metrics, streams that are cut, in parallel; memory and descriptors before, after."""
    script = (
        "import sys, time\nfrom pathlib import Path\n"
        "from groundstation.service.client import Client, live\n"
        "from groundstation.errors import GroundStationError\n"
        "path, end = Path(sys.argv[1]), time.monotonic() + float(sys.argv[2])\n"
        "while time.monotonic() < end:\n"
        "    try:\n"
        "        with Client(path) as client:\n"
        "            for _ in range(10): client.ask('GET', '/status')\n"
        "        stream = live(path)\n"
        "        for _ in range(3): next(stream)\n"
        "        stream.close()\n"
        "    except GroundStationError: time.sleep(0.05)\n"
    )

    def attack(seconds):
        command = [sys.executable, "-c", script, daemon.socket, str(seconds)]
        with contextlib.ExitStack() as programs:
            for client in [programs.enter_context(Program(command)) for _ in range(4)]:
                assert client.wait(60) == 0
        # the software craft remembers two seconds, so who is held up for longer loses some
        assert daemon.status()["link"]["lost"] == 0

    def settled():
        time.sleep(1.0)
        process = psutil.Process(daemon.process.pid)
        return process.memory_info().rss / 1e6, process.num_fds(), process.num_threads()

    with Daemon(tmp_path) as daemon:
        daemon.recording(samples=500)
        attack(2)
        before = settled()
        attack(4)
        after = settled()
        status = daemon.status()
        assert daemon.stop() == 0
    figure(
        "many clients",
        f"{after[0] - before[0]:+.1f} MB, descriptors {before[1]} -> {after[1]}, "
        f"threads {before[2]} -> {after[2]}",
    )
    assert after[0] - before[0] < 10
    assert after[1] <= before[1] + 1
    assert status["recording"]["dropped"] == 0
    assert status["faults"] == 0
    continuous(open_recording(daemon.only_file()))


def test_a_killed_daemon_leaves_its_socket_to_the_next_one(tmp_path):
    with Daemon(tmp_path / "a", socket_path=tmp_path / "c.sock") as first:
        first.recording(samples=500)
        killed_ns = time.time_ns()
        first.stop(signal.SIGKILL)
    with pytest.raises(GroundStationError, match="no groundstation is running"):
        ask(tmp_path / "c.sock", "GET", "/status")
    recording = open_recording(first.only_file())
    assert gaps(recording) == 0
    missing_s = (killed_ns - recording.samples.host_time_ns[-1]) * 1e-9
    figure("SIGKILL of the daemon", f"the last {missing_s:.2f} s are missing")
    with Daemon(tmp_path / "b", socket_path=tmp_path / "c.sock") as second:
        second.recording(samples=100)
        assert second.stop() == 0
    until(lambda: not (tmp_path / "c.sock").exists(), "the socket is removed")
