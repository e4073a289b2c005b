"""Why the event loop stood still: what a thread beside it saw, and what the kernel counted.

The kernel tells of every thread for how long it ran and for how long it was ready and waited for a
processor (``/proc/self/task/*/schedstat``), and of the machine for how long its host did not let it
run (steal). What is left of a delay the loop's thread spent waiting for something else: where, its
stack says.
"""

from __future__ import annotations

import contextlib
import gc
import os
import resource
import sys
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Self

POLL_S = 0.1
READ_S = 0.5
"""Between two readings of the kernel's figures, a file for each thread: as long as a delay is, from
which on it is told."""
KEPT = 8
"""Readings of the kernel's figures: those from before a delay are among them."""
MOST = 0.5
"""Share of a delay that makes a cause the cause."""
_PACKAGE = Path(__file__).parents[1]
_TICKS_S = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Figures:
    """Totals, s. ran, waited: thread -> on a processor, and ready without one. collected: by the
    garbage collector. stolen: from all processors of the machine by its host."""

    time_s: float = field(default_factory=time.monotonic)
    ran: dict[int, float] = field(default_factory=dict)
    waited: dict[int, float] = field(default_factory=dict)
    collected: float = 0.0
    stolen: float = 0.0

    @classmethod
    def now(cls, collected: float) -> Self:
        ran, waited = {}, {}
        for name in os.listdir("/proc/self/task"):
            with contextlib.suppress(OSError, ValueError):  # it has just ended
                text = Path(f"/proc/self/task/{name}/schedstat").read_text()
                ran[int(name)], waited[int(name)] = (int(one) / 1e9 for one in text.split()[:2])
        stolen = 0.0
        with contextlib.suppress(OSError, ValueError, IndexError), open("/proc/stat") as file:
            stolen = int(file.readline().split()[8]) / _TICKS_S / (os.cpu_count() or 1)
        return cls(time.monotonic(), ran, waited, collected, stolen)


class Witness:
    """Watches one thread's loop from another, and says after a delay what caused it.

    Made, and ``why`` called, in the thread that is watched. A context manager.
    """

    def __init__(self) -> None:
        self._watched, self._native = threading.get_ident(), threading.get_native_id()
        self._beat_s = time.monotonic()
        self._figures: deque[Figures] = deque(maxlen=KEPT)
        self._seen: Counter[str] = Counter()
        self._late_s = 0.0  # of the witness itself
        self._asleep_s = time.monotonic()
        self._faults = _page_faults()
        self._collected, self._began_s = 0.0, 0.0
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="witness", daemon=True)

    def __enter__(self) -> Self:
        self._figures.append(Figures.now(self._collected))
        gc.callbacks.append(self._collect)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stopped.set()
        self._thread.join()
        gc.callbacks.remove(self._collect)

    def beat(self) -> None:
        """The loop turns."""
        self._beat_s = time.monotonic()
        self._faults = _page_faults()
        self._seen.clear()
        self._late_s = 0.0

    def why(self, late_s: float) -> str:
        """What held the loop up for so long until now."""
        after = Figures.now(self._collected)
        begun_s = after.time_s - late_s
        earlier = [one for one in self._figures.copy() if one.time_s <= begun_s]
        before = earlier[-1] if earlier else self._figures[0]
        # it may still be about to wake
        witness_s = self._late_s + max(after.time_s - self._asleep_s - POLL_S, 0.0)
        text = explained(late_s, before, after, self._native, dict(self._seen), witness_s, _names())
        read = _page_faults() - self._faults
        return f"{text}; {read} pages of memory were read from the disk" if read else text

    def _watch(self) -> None:
        while True:
            self._asleep_s = time.monotonic()
            if self._stopped.wait(POLL_S):
                return
            now_s = time.monotonic()
            if now_s - self._beat_s < 3 * POLL_S:
                if now_s - self._figures[-1].time_s >= READ_S:
                    self._figures.append(Figures.now(self._collected))
                continue
            self._late_s += max(now_s - self._asleep_s - POLL_S, 0.0)
            frame = sys._current_frames().get(self._watched)
            if frame is not None:
                self._seen[place_of(frame)] += 1

    def _collect(self, phase: str, info: dict[str, int]) -> None:
        if threading.get_ident() != self._watched:
            return
        now_s = time.monotonic()
        if phase == "start":
            self._began_s = now_s
        else:
            self._collected += now_s - self._began_s


def explained(
    late_s: float,
    before: Figures,
    after: Figures,
    thread: int,
    seen: dict[str, int],
    witness_s: float,
    names: dict[int, str],
) -> str:
    """The largest cause of a delay of ``late_s``, in words.

    thread: the loop's. seen: places in which it was found, how often. witness_s: for how long the
    witness itself did not run though it wanted to. names: of threads.
    """

    def spent(one: int) -> float:
        ran = after.ran.get(one, 0.0) - before.ran.get(one, 0.0)
        return ran + after.waited.get(one, 0.0) - before.waited.get(one, 0.0)

    where = f" in {max(seen, key=lambda place: seen[place])}" if seen else ""
    collected = after.collected - before.collected
    stolen = after.stolen - before.stolen
    waited = after.waited.get(thread, 0.0) - before.waited.get(thread, 0.0)
    ran = after.ran.get(thread, 0.0) - before.ran.get(thread, 0.0)
    others = {one: spent(one) for one in after.ran if one != thread}
    busiest = max(others, key=lambda one: others[one], default=0)
    causes = {
        f"the machine's host gave it no processor for {stolen:.1f} s": stolen,
        f"garbage was collected for {collected:.1f} s": collected,
        f"ready to run and without a processor for {waited:.1f} s: the machine is overloaded": (
            waited
        ),
        f"it computed for {ran:.1f} s{where}": ran,
    }
    for text, share_s in causes.items():
        if share_s >= MOST * late_s:
            return text
    if witness_s >= MOST * late_s:  # no thread could run Python
        if others.get(busiest, 0.0) >= MOST * late_s:
            name = names.get(busiest, "without a name")
            return f"the thread '{name}' did not let go of the interpreter"
        return "nothing of the process ran: it was stopped, or the machine"
    return f"it waited{where}"


def place_of(frame: FrameType) -> str:
    """The innermost function of ours and, where that called another, the innermost of all."""
    inner, ours = frame, frame
    while not ours.f_code.co_filename.startswith(str(_PACKAGE)) and ours.f_back is not None:
        ours = ours.f_back
    if not ours.f_code.co_filename.startswith(str(_PACKAGE)):
        return _named(inner)
    return _named(ours) if ours is inner else f"{_named(inner)}, called by {_named(ours)}"


def _named(frame: FrameType) -> str:
    code = frame.f_code
    return f"{code.co_qualname} ({Path(code.co_filename).name}:{frame.f_lineno})"


def _page_faults() -> int:
    """Of this thread, those for which a disk was read."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_majflt


def _names() -> dict[int, str]:
    return {one.native_id: one.name for one in threading.enumerate() if one.native_id}
