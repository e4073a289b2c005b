"""The installed ``groundstation run --link usb`` as its own process, while the cable is pulled."""

import os
import subprocess
import time

import numpy as np
import psutil

from groundstation.recording.formats import open_recording
from groundstation.telemetry.packet import SAMPLE_TICKS
from support.daemons import COMMAND, Daemon
from support.waiting import until

CYCLES, EARLY = 30, 10
ABSENT_S = 20.0
UNPLUG_SEEN_S = 0.1
REPLUG_STREAMS_S = 2.0
STREAMED_FRAMES = 150
"""A cable stays in until the link has given out what it holds back at first (128)."""
PATIENCE_S = 6000.0
"""Virtual: it runs on while the program is loaded from the host, which may be busy."""
LOOK_S = 0.05
"""Looking is work, and this machine has one slow core."""
NOBODY = "65534"


def told(daemon, words):
    return until(lambda: words in daemon.stderr, words, PATIENCE_S)


def held(process):
    """What a leak would make larger: descriptors, threads, bytes."""
    with process.oneshot():
        return process.num_fds(), process.num_threads(), process.memory_info().rss


def cpu_share(process, span_s):
    before, start_s = process.cpu_times(), time.monotonic()
    time.sleep(span_s)
    after = process.cpu_times()
    used_s = after.user + after.system - before.user - before.system
    return used_s / (time.monotonic() - start_s)


def test_a_daemon_that_began_without_a_bridge_records_thirty_cables_without_a_leak(
    bridge, tmp_path
):
    plugged, pulled, holding = [], [], []

    def stream():
        before = bridge.counts()
        bridge.plug()
        plugged.append(time.time())
        wanted = before.good + STREAMED_FRAMES
        until(lambda: bridge.counts().good > wanted, "a stream", PATIENCE_S, LOOK_S)

    with Daemon(tmp_path, "--link", "usb") as daemon:
        told(daemon, "no USB device 0483:5741 is plugged in; waiting for one")
        # loaded by then, from the host, in real time, while time here runs on
        assert until(daemon.status, "an answer", PATIENCE_S, LOOK_S)["link"]["state"] == "opening"
        process = psutil.Process(daemon.process.pid)
        share = cpu_share(process, ABSENT_S)
        assert daemon.status()["link"]["state"] == "opening"
        stream()
        for _ in range(CYCLES):
            bridge.unplug()
            pulled.append(time.time())
            stream()
            holding.append(held(process))
        bridge.unplug()
        pulled.append(time.time())
        until(lambda: daemon.stderr.count("was unplugged") == len(pulled), "its loss", PATIENCE_S)
        theirs = bridge.counts()
        assert daemon.stop() == 0
        assert "Traceback" not in daemon.stderr

    recording = open_recording(daemon.only_file(), raw=True)
    at_s = {
        kind: np.array([e["time_ns"] * 1e-9 for e in recording.events if e["kind"] == kind])
        for kind in ("lost", "streaming")
    }
    seen_s = at_s["lost"] - pulled
    again_s = at_s["streaming"] - plugged
    # Ten cables each: a moment may find a helper of the event loop's pool that just began or ended,
    # a leak of one thread in five cables moves the middle by three.
    early, late = (np.median(part, axis=0) for part in (holding[:EARLY], holding[-EARLY:]))
    print(f"CPU while absent: {100 * share:.2f} %")
    print(f"unplug seen in {seen_s.max():.4f} s at most, streaming again in {again_s.max():.3f} s")
    print(f"descriptors, threads, bytes: {early} at first, {late} at the end")
    assert share < 0.01
    assert seen_s.max() < UNPLUG_SEEN_S
    assert again_s.max() < REPLUG_STREAMS_S
    assert late[0] == early[0]
    assert late[1] <= early[1] + 1
    assert late[2] - early[2] < 2 << 20
    assert recording.damage == []
    assert len(recording.raw) == theirs.packets
    assert theirs.lost == 0
    samples = recording.samples
    assert np.unique(samples.segment).tolist() == list(range(1 + CYCLES))
    inside = np.diff(samples.segment) == 0
    assert np.diff(samples.ticks)[inside].max() < 1.5 * SAMPLE_TICKS
    assert np.bincount(samples.segment).min() > STREAMED_FRAMES / 2 - 5


def test_a_user_without_permission_is_told_of_the_rule_and_the_daemon_waits(bridge, tmp_path):
    """Nobody may read the program's files here, wherever they are, and write no device."""
    bridge.plug()
    (tmp_path / "sessions").mkdir()
    home = tmp_path / "home"
    home.mkdir()
    os.chmod(tmp_path.parent, 0o755)
    for folder in (tmp_path, home):
        os.chown(folder, int(NOBODY), int(NOBODY))
    with (home / "stderr").open("wb") as errors:
        daemon = subprocess.Popen(
            ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups",
             "--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search",
             COMMAND, "run", "--link", "usb"],
            cwd=tmp_path, stderr=errors, stdout=subprocess.DEVNULL,
            env={**os.environ, "HOME": str(home), "XDG_RUNTIME_DIR": str(home),
                 "GROUNDSTATION_SOCKET": str(home / "control.sock")},
        )  # fmt: skip
    try:
        said = home / "stderr"
        until(lambda: "no permission" in said.read_text(), "no permission", PATIENCE_S)
        assert "groundstation install udev --print | sudo tee" in said.read_text()
        assert daemon.poll() is None
    finally:
        daemon.terminate()
        status = daemon.wait()
    assert status == 0, said.read_text()
