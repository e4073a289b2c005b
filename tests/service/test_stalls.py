"""When the event loop stands still the daemon says for how long, and what did it."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Callable

import pytest

from groundstation.service.station import Figures, Health, explained
from support.programs import Program

HELD_S = 0.8


def what_held_up(hold_up: Callable[[], None]) -> str:
    """What the daemon's health says of a loop that was held up so."""
    told: list[str] = []

    async def session() -> Health:
        health = Health(lambda kind, text: told.append(f"{kind}: {text}"))
        watching = asyncio.create_task(health.watch())
        await asyncio.sleep(0.3)
        hold_up()
        await asyncio.sleep(0.3)
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        return health

    health = asyncio.run(session())
    assert any(one.startswith("held up: ") and health.held_up_by in one for one in told)
    assert 0.5 <= health.lag_s < 30.0
    status = health.status([])
    assert status["loop_lag_ms"] == pytest.approx(1e3 * health.lag_s, abs=0.1)
    assert status["held_up_by"] == health.held_up_by
    return health.held_up_by


def require_told(expected: str, hold_up: Callable[[], None]) -> None:
    """Once in five times: an overloaded machine holds it up for longer, and that is told then."""
    texts: list[str] = []
    while not any(expected in text for text in texts):
        assert len(texts) < 5, texts
        texts.append(what_held_up(hold_up))


def wait_for_a_lock() -> None:
    lock = threading.Lock()
    lock.acquire()
    threading.Timer(HELD_S, lock.release).start()
    with lock:
        pass


def stop_the_process() -> None:
    pid = os.getpid()
    order = f"kill -STOP {pid}; sleep {HELD_S}; kill -CONT {pid}"
    with Program(["sh", "-c", order]) as resumes:
        resumes.wait()


def let_another_thread_keep_the_interpreter() -> None:
    """By one operation that takes that long and lets nobody in between."""
    exponent = 200_000
    begun_s = time.thread_time()
    7**exponent
    taken_s = time.thread_time() - begun_s
    long = round(exponent * (HELD_S / taken_s) ** (1 / 1.585))  # Karatsuba's exponent

    def compute() -> None:
        7**long
        told.wait(30.0)  # as one that goes on does

    threading.Thread(target=compute, name="arithmetic").start()


told = threading.Event()


def test_a_loop_that_waits_for_a_lock_is_told_with_the_place() -> None:
    require_told("it waited in wait_for_a_lock (test_stalls.py:", wait_for_a_lock)


def test_a_process_that_was_stopped_is_not_blamed_on_anything_of_ours() -> None:
    require_told("nothing of the process ran", stop_the_process)


NONE = Figures(0.0, {1: 10.0, 2: 5.0}, {1: 1.0, 2: 1.0}, 0.0, 0.0)


@pytest.mark.parametrize(
    ("after", "witness_s", "told"),
    [
        (
            Figures(4.0, {1: 10.1}, {1: 4.8}),
            3.0,
            "ready to run and without a processor for 3.8 s: the machine is overloaded",
        ),
        (Figures(4.0, {1: 13.9}, {1: 1.1}), 0.0, "it computed for 3.9 s in fit (fit.py:3)"),
        (Figures(4.0, {1: 13.9}, {1: 1.1}, 3.5), 0.0, "garbage was collected for 3.5 s"),
        (
            Figures(4.0, {1: 13.9}, {1: 1.1}, 0.0, 2.5),
            3.0,
            "the machine's host gave it no processor for 2.5 s",
        ),
        (
            Figures(4.0, {1: 10.1, 2: 6.0}, {1: 1.0, 2: 3.8}),
            3.6,
            "the thread 'recorder' did not let go of the interpreter",
        ),
        (Figures(4.0, {1: 10.1, 2: 5.1}, {1: 1.0, 2: 1.0}), 0.1, "it waited in fit (fit.py:3)"),
    ],
)
def test_the_largest_part_of_a_delay_is_its_cause(
    after: Figures, witness_s: float, told: str
) -> None:
    seen = {"fit (fit.py:3)": 9, "sync (mcap_file.py:1)": 1}
    assert explained(4.0, NONE, after, 1, seen, witness_s, {2: "recorder"}) == told


def test_a_thread_that_keeps_the_interpreter_is_named() -> None:
    try:
        require_told(
            "the thread 'arithmetic' did not let go of the interpreter",
            let_another_thread_keep_the_interpreter,
        )
    finally:
        told.set()
