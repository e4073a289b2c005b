from __future__ import annotations

import signal
import subprocess
import sys
import time

import psutil
import pytest

from groundstation.viewer.child import Child
from support.programs import Program


def finished(child):
    deadline = time.monotonic() + 30
    while (status := child.poll()) is None:
        assert time.monotonic() < deadline, "the child did not end"
        time.sleep(0.01)
    return status


def python(code, **options):
    return Child([sys.executable, "-c", code], **options)


def test_the_exit_status_and_the_last_line_are_kept():
    child = python(
        "import sys; print('first\\n\\x1b[31mport 9 is busy\\x1b[0m', file=sys.stderr); sys.exit(5)"
    )
    assert finished(child) == 5
    assert child.last_words == "port 9 is busy"


def test_a_silent_end_is_described():
    child = python("import sys; sys.exit(5)")
    finished(child)
    assert child.last_words == "exit status 5"


def test_a_talkative_child_never_waits_for_its_reader_for_long():
    child = python("import sys; sys.stderr.write('x' * 1_000_000 + '\\nlast')")
    assert finished(child) == 0
    assert child.last_words == "last"


def test_a_stopped_child_can_be_killed():
    child = python("import signal; signal.pause()")
    psutil.Process(child.pid).send_signal(signal.SIGSTOP)
    child.kill()
    assert finished(child) == -signal.SIGKILL
    assert child.last_words == "killed by SIGKILL"


def test_a_missing_program_says_so():
    child = Child(["/nowhere/rerun"])
    assert finished(child) == 127
    assert child.last_words == "/nowhere/rerun: No such file or directory"


def test_its_environment_can_be_extended():
    child = python("import os, sys; sys.exit(int(os.environ['N']))", environment={"N": "7"})
    assert finished(child) == 7


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_it_does_not_outlive_its_parent(how):
    parent = Program(
        [
            sys.executable,
            "-c",
            "import sys, signal\n"
            "from groundstation.viewer.child import Child\n"
            "child = Child([sys.executable, '-c', 'import signal; signal.pause()'])\n"
            "print(child.pid, flush=True)\n"
            "signal.pause()",
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    with parent:
        child = psutil.Process(int(parent.stdout.readline()))
        parent.send_signal(how)
        parent.wait()
        _, alive = psutil.wait_procs([child], timeout=30)
        assert not alive
