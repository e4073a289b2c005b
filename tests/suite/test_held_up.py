"""What the machine's load ended is run again, what a fault ended fails."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import pytest

from support.programs import Program
from support.waiting import HeldUpError, children, in_real_time, waited_s

COMPUTE = "while True: pass"
RUNS = []
SLEEP = "import time; print(flush=True); time.sleep(100)"


@contextlib.contextmanager
def program(text, core=None):
    with Program([sys.executable, "-c", text], stdout=subprocess.PIPE) as started:
        if core is not None:
            os.sched_setaffinity(started.pid, {core})
        yield started


@contextlib.contextmanager
def crowded():
    """A program that computes on a core which it shares with three others."""
    core = min(os.sched_getaffinity(0))
    with contextlib.ExitStack() as stack:
        flight, *_ = [stack.enter_context(program(COMPUTE, core)) for _ in range(4)]
        yield flight


def ended(flight):
    """A flight that is ended a second after it began to be watched."""
    with in_real_time(lambda: [flight.pid]):
        time.sleep(1.2)
        raise AssertionError("no telemetry")


def test_a_flight_that_ends_while_the_machine_holds_its_programs_up_is_told_apart():
    what = r"held python.* up for \d\.\d+ s: no telemetry"
    with crowded() as flight, pytest.raises(HeldUpError, match=what):
        ended(flight)


@pytest.mark.parametrize("stands_still", [True, False])
def test_a_flight_whose_program_stands_still_or_waits_fails_however_busy_the_machine(stands_still):
    with crowded(), program(SLEEP) as flight:
        flight.stdout.readline()  # its start competes for a core
        if stands_still:
            flight.send_signal(signal.SIGSTOP)
        time.sleep(0.2)
        with pytest.raises(AssertionError, match="no telemetry") as failed:
            ended(flight)
        assert failed.type is AssertionError


def test_what_the_machine_ended_is_run_again():
    RUNS.append("a run")
    if len(RUNS) == 1:
        raise HeldUpError("the first time")


def test_what_was_held_up_and_went_well_goes_on():
    with crowded() as flight, in_real_time(lambda: [flight.pid]):
        time.sleep(0.5)


def test_a_program_that_shares_its_core_waits_for_it():
    with crowded() as flight:
        assert flight.pid in children()
        before = waited_s(flight.pid)[flight.pid]
        time.sleep(1.0)
        assert waited_s(flight.pid)[flight.pid] - before > 0.25
