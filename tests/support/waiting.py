"""Waiting for what programs do in their own time, and what a busy machine ended of it."""

import asyncio
import contextlib
import os
import threading
import time
from collections import deque
from pathlib import Path

PATIENCE_S = 90.0
"""A machine that is busy with other tests holds programs up for many seconds."""
EVERY_S, SPAN_S = 0.1, 1.0
HELD_UP_S = 0.25
"""In ``SPAN_S``. Telemetry is taken for lost after 0.5 s (``LinkState.SILENT``), in which craft,
relay and daemon have to run one after the other."""
LAST_S = 10.0
"""What was that long ago did not end a flight: motors are watched for 3 s after it, parameters
are put back."""
WHOLE_TEST_S = 300.0
"""Where a test goes on to wait for what did not come."""


def until(condition, what, timeout_s=PATIENCE_S, every_s=0.01):
    """Wait for ``condition`` to give something true; that."""
    deadline = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline, f"never happened: {what}"
        time.sleep(every_s)
    return value


async def eventually(condition, what="what is waited for"):
    """Return once ``condition()`` holds; what: says what never happened where it does not."""
    try:
        async with asyncio.timeout(PATIENCE_S):
            while not condition():
                await asyncio.sleep(0.005)
    except TimeoutError:
        raise AssertionError(f"never happened in {PATIENCE_S:g} s: {what}") from None


class HeldUpError(AssertionError):
    """The machine did not give a test the real time that it needs: pytest runs it again, three
    times at most (``--only-rerun`` in pyproject.toml)."""


@contextlib.contextmanager
def in_real_time(programs=lambda: [os.getpid(), *children()], last_s=LAST_S):
    """Raises HeldUpError for what fails in here where the machine held a program up before it.

    programs: their process ids; by default this one and those it started. last_s: how long before.
    """
    with Watch(programs, last_s) as watch:
        try:
            yield
        except Exception as error:
            held_s, name = watch.longest()
            if held_s < HELD_UP_S:
                raise
            why = f"the machine held {name} up for {held_s:.2f} s: {error}"
            raise HeldUpError(why[:500]) from error


def waited_s(pid):
    """How long each thread of a program was ready to run and did not: thread id -> s."""
    found = {}
    for thread in _listed(f"/proc/{pid}/task"):
        with contextlib.suppress(OSError):  # it has ended
            text = Path(f"/proc/{pid}/task/{thread}/schedstat").read_text()
            found[int(thread)] = int(text.split()[1]) * 1e-9
    return found


def children():
    """Process ids of what this process has started."""
    found = []
    for thread in _listed("/proc/self/task"):
        with contextlib.suppress(OSError):
            found += map(int, Path(f"/proc/self/task/{thread}/children").read_text().split())
    return found


def _listed(folder):
    try:
        return os.listdir(folder)
    except OSError:
        return []


class Watch:
    """How long the machine holds programs up: looks ten times a second, in its own thread."""

    def __init__(self, programs, last_s=LAST_S):
        self._programs = programs
        self._seen = deque(maxlen=round(SPAN_S / EVERY_S) + 1)
        self._worst = deque(maxlen=round(last_s / EVERY_S))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()

    def longest(self):
        """(s, name) of the program that was held up most in any ``SPAN_S`` lately."""
        return max(self._worst, default=(0.0, "nothing"))

    def _look(self):
        while not self._ended.wait(EVERY_S):
            now_s, now = time.monotonic(), {pid: waited_s(pid) for pid in self._programs()}
            self._seen.append((now_s, now))
            # a look that comes late itself must not make a longer span of it
            before = next(seen for at_s, seen in self._seen if at_s >= now_s - SPAN_S - EVERY_S)
            rises = [
                (waited - before.get(pid, {}).get(thread, waited), pid)
                for pid, threads in now.items()
                for thread, waited in threads.items()
            ]
            rise_s, pid = max(rises, default=(0.0, 0))
            self._worst.append((rise_s, _name(pid)))


def _name(pid):
    with contextlib.suppress(OSError):
        words = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
        return " ".join(Path(word).name for word in words[:4]).strip()
    return str(pid)
