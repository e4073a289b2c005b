"""How a command ends: one line, the right status, never a traceback."""

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from groundstation.recording.formats import open_recording
from support import RECORDINGS
from support.daemons import COMMAND, Daemon, groundstation, require_failure
from support.programs import Program, run_program
from support.waiting import until

EXCERPT = RECORDINGS / "thesis_excerpt.csv"


def in_shell(command, folder):
    return run_program(
        ["sh", "-c", command.replace("groundstation", str(COMMAND), 1)],
        cwd=folder,
        env={**os.environ, "GROUNDSTATION_SOCKET": str(folder / "c.sock")},
        timeout=60,
    )


@pytest.mark.parametrize("arguments", ["inspect", "inspect --json", "--help"])
def test_a_full_device_for_the_output_is_one_line(tmp_path, arguments):
    file = "" if arguments == "--help" else EXCERPT
    assert "No space left" in require_failure(
        in_shell(f"groundstation {arguments} {file} >/dev/full", tmp_path)
    )


@pytest.mark.parametrize("where", [">/dev/full", "<&- >&- 2>&-"])
def test_a_daemon_without_a_place_to_print_records_all_the_same(tmp_path, where):
    result = in_shell(f"groundstation run --link replay:{EXCERPT} {where}", tmp_path)
    assert result.returncode == 0, result.stderr
    assert "Traceback" not in result.stderr
    (path,) = (tmp_path / "sessions").glob("*.mcap")
    recording = open_recording(path)
    assert (len(recording.samples), recording.damage) == (25, [])


def test_names_that_are_not_utf_8_are_shown_recorded_and_answered(tmp_path):
    name = os.fsdecode(b"fl\xff.csv")
    shutil.copy(EXCERPT, tmp_path / name)
    folder = os.fsdecode(b"s\xfe")
    result = groundstation(
        "run", "--link", f"replay:{name}", "--recordings", folder, cwd=tmp_path,
        socket_path=tmp_path / "c.sock",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert r"fl\udcff.csv" in result.stdout
    (path,) = (tmp_path / folder).glob("*.mcap")
    recording = open_recording(path)
    assert len(recording.samples) == 25
    assert recording.link == r"replay:fl\udcff.csv"
    assert any("fl" in event["text"] for event in recording.events)
    assert groundstation("inspect", name, cwd=tmp_path).returncode == 0
    with Daemon(tmp_path, "--recordings", folder) as daemon:
        assert daemon.recording()["recording"]["file"].startswith(folder)
        assert daemon.stop() == 0


def test_sighup_finishes_the_recording(tmp_path):
    """The terminal was closed."""
    with Daemon(tmp_path) as daemon:
        daemon.recording(samples=100)
        assert daemon.stop(signal.SIGHUP) == 0
        assert open_recording(daemon.only_file()).damage == []


def test_an_early_interrupt_is_one_line(tmp_path):
    """At whatever moment it comes once the program runs: it imports for most of this time."""
    begun = time.monotonic()
    run_program([sys.executable, "-c", "pass"], check=True)
    python_s = 2 * (time.monotonic() - begun)  # until then the interpreter alone answers
    said_of = {130: "groundstation: interrupted\n", 143: "groundstation: terminated\n"}
    for number, delay_s in (
        *((signal.SIGINT, 0.05), (signal.SIGTERM, 0.1)),
        *((signal.SIGINT, 0.3), (signal.SIGTERM, 0.7)),
    ):
        with Program(
            [COMMAND, "inspect", EXCERPT, "--json"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            time.sleep(python_s + delay_s)  # any moment will do
            process.send_signal(number)
            said = process.communicate(timeout=60)[1]
        assert process.returncode in (0, 128 + number, -number)
        if process.returncode > 0:
            assert said == said_of[process.returncode]


def test_ctrl_c_does_not_wait_for_the_compiler(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "nothing_compiled_yet"))
    with Daemon(tmp_path) as daemon:
        daemon.status_when(lambda status: status["link"]["state"] == "opening", "opening")
        assert daemon.stop() == 0
        assert "stopped before it was open" in daemon.stderr
        assert "received 0 samples" in daemon.stdout
        assert daemon.files() == []


def test_the_daemon_answers_while_the_decoder_is_compiled(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "nothing_compiled_yet"))
    flight = RECORDINGS / "stand_in_flight.mcap"
    with Daemon(tmp_path, "--link", f"replay:{flight}", "--speed", "max") as daemon:
        until(lambda: "preparing the decoder" in daemon.stderr, "preparing")
        assert daemon.status()["link"]["state"] == "closed"
        assert daemon.process.poll() is None
        assert daemon.stop() == 0


def test_channels_the_packet_csv_cannot_leave_out_are_told(tmp_path):
    out = tmp_path / "log.csv"
    result = groundstation("convert", RECORDINGS / "microsd_log16", out)
    assert result.returncode == 0
    left_out, duty = result.stderr.strip().splitlines()
    assert "has no battery, roll, pitch, yaw: written as 0; --physical" in left_out
    assert "the motors' duty is not known" in duty
    quiet = groundstation("convert", RECORDINGS / "microsd_log16", tmp_path / "p.csv", "--physical")
    assert (quiet.returncode, quiet.stderr) == (0, "")
    assert groundstation("convert", EXCERPT, tmp_path / "e.csv").stderr == ""


def test_a_failed_recording_and_the_good_one_after_it_are_told_apart(tmp_path):
    with Daemon(tmp_path) as daemon:
        daemon.recording(samples=100)
        bad = daemon.only_file()
        bad.unlink()
        daemon.status_when(lambda status: status["recording"]["resumed"], "a new file")
        daemon.recording(samples=100)
        assert daemon.stop() == 1
        assert f"{bad.name}: recording stopped: the file was removed" in daemon.last_line
        assert f"{daemon.only_file().name} is complete" in daemon.last_line


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("fit body x.csv --with dead_time --with rotor_drag -o body.json", "separated by commas"),
        ("run --log acc.x --log acc.y", "separated by commas"),
        ("pid design --model thesis --seed 1 --axis roll --axis yaw --seed 2", "--seed: given 2"),
    ],
)
def test_an_option_of_one_value_that_is_given_twice_is_refused(tmp_path, command, said):
    assert said in require_failure(in_shell(f"groundstation {command}", tmp_path))


@pytest.mark.parametrize(
    ("words", "successor"),
    [
        (["jobs", "list"], "POST /jobs/start"),
        (["models", "watch", "ID"], "POST /models/watch"),
        (["config", "--reload"], "the next start"),
        (["recordings"], "inspect FOLDER"),
        (["config", "--show"], "'groundstation config' shows it"),
        (["export", "header"], "groundstation_telemetry.h"),
        (["fit", "body", "flight.mcap", "--rerun=shown.rrd"], "--html draws the same series"),
        (["bench", "motor", "-o", "motor.json"], "'groundstation fit motor' fits"),
        (["inspect", "flight.mcap", "--thumbnail", "small.svg"], "opens a recording"),
        (["pid", "evaluate", "--thesis"], "'groundstation thesis'"),
    ],
)
def test_what_is_gone_is_refused_with_what_does_its_work_now(words, successor):
    from typer.testing import CliRunner

    from groundstation.cli.app import app

    result = CliRunner().invoke(app, words, env={"COLUMNS": "400"})
    assert result.exit_code == 2
    assert successor in result.output
