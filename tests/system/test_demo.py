"""``groundstation demo`` as a newcomer meets it. The whole of it runs in CI: ``make demo``."""

import signal
import subprocess

from installed import COMMAND, groundstation, require_failure, until
from programs import Program

from groundstation.recording.open_recording import open_recording


def test_a_folder_with_something_in_it_is_refused_and_left_alone(tmp_path):
    (tmp_path / "mine").write_text("precious")
    line = require_failure(groundstation("demo", "-o", tmp_path))
    assert "not an empty folder" in line
    assert "-o" in line
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_ctrl_c_ends_it_in_one_line_and_what_was_recorded_stays(tmp_path):
    folder = tmp_path / "story"
    with Program(
        [COMMAND, "demo", "--seed", "4", "-o", folder],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as demo:
        until((folder / "bench.csv").exists, "the bench is recorded")
        script = folder / "commands.sh"
        until(lambda: "bench.csv" in script.read_text(), "the recording is finished")
        demo.send_signal(signal.SIGINT)
        said, error = demo.communicate(timeout=60)
    assert demo.returncode == 130
    assert error == "groundstation: interrupted\n"
    assert "$ python -m firmware_sim" in said
    assert len(open_recording(folder / "bench.csv").samples) > 19000


def test_a_stage_that_fails_is_named_with_what_its_command_said(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "0")
    line = require_failure(groundstation("demo", "-o", tmp_path / "story"))
    assert "stage 'A motor on the bench'" in line
    assert "python -m firmware_sim" in line
    assert "log.txt" in line
