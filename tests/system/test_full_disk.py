"""A disk that fills up while the daemon records."""

from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_scan import recover
from support.daemons import Daemon, gaps, in_process


def run_on(disk, folder, low_space_mb):
    config = folder / "config.toml"
    config.write_text(
        f"[recording]\nfolder = '{disk}'\nlow_space_mb = {low_space_mb}\n[link]\nspeed = 20.0\n"
    )
    return Daemon(folder, "--config", config)


def require_one_line(daemon, mentions):
    assert daemon.last_line.startswith("groundstation: ")
    assert mentions in daemon.last_line
    assert daemon.stderr.count("groundstation: ") == 1
    assert "Traceback" not in daemon.stderr


def require_kept(path, samples):
    """All that the daemon said was written is there, without a gap."""
    recording = open_recording(path, raw=True)
    assert len(recording.samples) >= samples > 0
    assert gaps(recording) == 0
    return recording


ENDED = {"failed": "No space left on device", "low_space": "the disk is almost full"}
"""The last write fails, or just before it there is no room for the summary."""


def test_a_disk_that_is_full_ends_the_recording_but_not_the_daemon(small_disk, tmp_path):
    disk = small_disk("600k")
    with run_on(disk, tmp_path, 0.0) as daemon:
        status = daemon.status_when(lambda s: s["recording"]["state"] in ENDED, "the disk is full")
        assert status["link"]["state"] == "streaming"
        why = ENDED[status["recording"]["state"]]
        assert why in status["recording"]["text"]
        assert daemon.stop() == 1
        require_one_line(daemon, why)
    (path,) = disk.glob("*.mcap")
    assert str(path) in daemon.last_line
    require_kept(path, samples=1000)
    repair = recover(path, tmp_path / "repaired.mcap")
    kept = path if repair.sound else repair.output
    assert in_process("inspect", kept).returncode == 0


def test_a_disk_that_is_almost_full_gets_a_finished_recording(small_disk, tmp_path):
    disk = small_disk("1200k")
    with run_on(disk, tmp_path, 0.5) as daemon:
        status = daemon.status_when(
            lambda s: s["recording"]["state"] == "low_space", "the disk is almost full"
        )
        assert daemon.stop() == 1
        require_one_line(daemon, "the disk is almost full")
    (path,) = disk.glob("*.mcap")
    recording = require_kept(path, status["recording"]["samples"])
    assert recording.damage == []
    assert recover(path).sound


def test_a_disk_without_room_is_refused_at_the_start(small_disk, tmp_path):
    disk = small_disk("600k")
    with run_on(disk, tmp_path, 64) as daemon:
        assert daemon.wait() == 1
        require_one_line(daemon, "make room")
    assert list(disk.glob("*")) == []


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "occupied").write_text("a file")
    with Daemon(tmp_path, "--recordings", "occupied") as daemon:
        assert daemon.wait() == 1
        require_one_line(daemon, "occupied")
