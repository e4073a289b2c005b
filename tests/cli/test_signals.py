"""Signals to a program whose loop may be stuck, each in a process of its own."""

import contextlib
import signal
import subprocess
import sys

import pytest

from support.programs import Program

PROGRAM = """
import asyncio, time
from groundstation.cli.run import stopped_by_signals

def say(text):
    print(text, flush=True)

async def main():
    stopped = asyncio.Event()
    with stopped_by_signals(stopped.set, lambda: say("last resort")):
        say("ready")
        await stopped.wait()
        say("stopping")
        {end}
    say("ended")

asyncio.run(main())
"""


@pytest.fixture
def started():
    with contextlib.ExitStack() as programs:

        def start(end):
            process = programs.enter_context(
                Program(
                    [sys.executable, "-c", PROGRAM.format(end=end)],
                    stdout=subprocess.PIPE,
                    text=True,
                )
            )
            assert process.stdout.readline() == "ready\n"
            return process

        yield start


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_asks_the_program_to_stop(started, number):
    process = started("pass")
    process.send_signal(number)
    assert process.communicate(timeout=30)[0] == "stopping\nended\n"
    assert process.returncode == 0


@pytest.mark.parametrize("stuck", ["await asyncio.sleep(60)", "time.sleep(60)"])
def test_the_second_ends_what_is_stuck_after_the_last_resort(started, stuck):
    process = started(stuck)
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "stopping\n"
    process.send_signal(signal.SIGTERM)
    assert process.communicate(timeout=30)[0] == "last resort\n"
    assert process.returncode == 128 + signal.SIGTERM


def test_impatience_does_not_spoil_an_orderly_end(started):
    process = started("await asyncio.sleep(0.2)")
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "stopping\n"
    for _ in range(3):
        process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=30)[0] == "ended\n"
    assert process.returncode == 0


def test_a_hang_up_that_is_ignored_stays_so():
    program = PROGRAM.format(end="pass").replace(
        "asyncio.run(main())",
        "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN); asyncio.run(main())",
    )
    with Program([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGHUP)
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=30)[0] == "stopping\nended\n"
