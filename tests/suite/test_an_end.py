"""The suite ends, whatever its tests do: nothing that they start goes on, no stage has no limit."""

import os
import re
import sys
from subprocess import TimeoutExpired

import psutil
import pytest

from support import ROOT
from support.programs import Program, run_program
from support.waiting import until

DEAF = 'trap "" INT TERM HUP; '
STARTS = f"{DEAF} setsid sleep 600 & (setsid sleep 600 & echo $! $$); wait"
"""A shell that hears no signal, and what it starts in sessions apart: a child and an orphan."""


def started(said):
    """The processes of ``STARTS``, by what the shell says."""
    orphan, shell = map(psutil.Process, map(int, said.split()))
    return [shell, orphan, until(shell.children, "the child")[0]]


def require_gone(processes):
    until(lambda: not any(map(alive, processes)), "the end of what was started")


def alive(process):
    try:
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_what_a_test_starts_ends_with_it_however_it_fails():
    found = []
    with pytest.raises(AssertionError):
        fail_beside(found)
    require_gone(found)


def fail_beside(found):
    with Program(["sh", "-c", STARTS], stdout=-1) as shell:
        found += started(shell.stdout.readline())
        raise AssertionError


def test_a_command_that_takes_too_long_ends_with_what_it_started():
    with pytest.raises(TimeoutExpired) as late:
        run_program(["sh", "-c", STARTS], timeout=0.5)
    for pid in map(int, late.value.output.split()):
        assert not psutil.pid_exists(pid) or not alive(psutil.Process(pid))


def test_what_tests_started_ends_when_they_are_killed():
    code = (
        "import os, signal, sys\n"
        "from support.programs import Program\n"
        f"Program(['sh', '-c', {STARTS!r}])\n"
        "sys.stdin.readline()\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "tests")}
    with Program([sys.executable, "-c", code], stdin=-1, stdout=-1, env=environment) as tests:
        processes = started(tests.stdout.readline())
        tests.communicate(b"\n")
    require_gone(processes)


def test_a_suite_in_the_background_of_a_script_ends_though_a_test_waits_for_ever(tmp_path):
    (tmp_path / "conftest.py").write_text((ROOT / "tests" / "conftest.py").read_text())
    (tmp_path / "test_hangs.py").write_text(
        "import signal\n"
        "from support.programs import Program\n"
        "def test_programs_hear_ctrl_c():\n"
        "    with Program(['sleep', '600']) as program:\n"
        "        program.send_signal(signal.SIGINT)\n"
        "        assert program.wait() == -signal.SIGINT\n"
        "def test_waits_for_ever():\n"
        f"    with Program(['sh', '-c', {DEAF + 'while :; do sleep 600; done'!r}]) as program:\n"
        "        program.wait()\n"
    )
    (tmp_path / "pytest.ini").write_text(f"[pytest]\ntimeout = 2\npythonpath = {ROOT / 'tests'}\n")
    deaf = ["sh", "-c", 'trap "" INT; exec "$@"', "sh", sys.executable, "-m", "pytest", "-q"]
    once = {**os.environ, "CI": ""}  # where a test that fails is run again
    done = run_program(
        [*deaf, "-p", "no:cacheprovider", tmp_path], cwd=tmp_path, timeout=60, env=once
    )
    assert "1 failed, 1 passed" in done.stdout
    assert "Timeout (>2.0s)" in done.stdout


def test_a_stage_that_runs_out_of_its_time_is_named():
    stage = run_program([ROOT / ".ci" / "stage", "a nap", "1", "sleep", "600"])
    assert stage.returncode == 124
    assert stage.stderr == ".ci/run: 'a nap' ran out of its 1 s\n"
    failed = run_program([ROOT / ".ci" / "stage", "a nap", "10", "false"])
    assert failed.returncode == 1
    assert re.fullmatch(r"\.ci/run: 'a nap' took \d s, status 1\n", failed.stderr)


def test_every_stage_of_ci_has_a_limit():
    text = re.sub(r"#.*|\\\n", "", (ROOT / ".ci" / "run").read_text())
    command = r"\b(?:make|apt-get) [-.\w]"
    stages = re.findall(rf'\.ci/stage "[^"]+" \d+\s+{command}', text)
    assert len(stages) == len(re.findall(command, text)) >= 6


def test_only_one_helper_starts_processes():
    """Inside the virtual machine they end with that."""
    found = [
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "tests").rglob("*.py")
        if re.search(r"\bsubprocess\.(run|Popen|call|check)|\bos\.(spawn|system|popen)",
                     path.read_text())
    ]  # fmt: skip
    inside = [name for name in found if not name.startswith("tests/usb_vm/guest/")]
    assert inside == ["tests/support/programs.py"]
