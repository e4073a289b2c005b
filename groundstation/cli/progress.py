"""What a command waits for: after a second of silence a word and a bar on a terminal's standard
error; nothing where that is none. Every command is watched, and what is printed ends the silence.
"""

from __future__ import annotations

import itertools
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from groundstation.compiling import compiles
from groundstation.paths import write_whole
from groundstation.text import printable

SILENT_S = 1.0
TURN_S = 0.15
WIDTH = 24
TOLD = "GROUNDSTATION_PROGRESS"
"""Variable that names the file in which a program that waits for this one finds the same."""
CLEAR = "\r\033[K"


class Waiting:
    """The line that is drawn, by a thread of its own.

    share: done, 0 to 1; None where nobody knows. what: is being done.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._drawn = False
        self._spoken_s = time.monotonic()
        self.share: float | None = None
        self.what = "working"
        self._thread = threading.Thread(target=self._draw, name="waiting", daemon=True)

    def begin(self) -> None:
        self._thread.start()

    def interrupt(self) -> None:
        """Something is to be printed now: the line goes, and the silence begins anew."""
        with self._lock:
            self._clear()
            self._spoken_s = time.monotonic()

    def end(self) -> None:
        """Nothing is drawn any more. Safe to call twice."""
        with self._lock:
            self._ended.set()
            self._clear()

    def _draw(self) -> None:
        for turn in itertools.count():
            if self._ended.wait(TURN_S):
                return
            with self._lock:
                silent_s = time.monotonic() - self._spoken_s
                if silent_s >= SILENT_S and not self._ended.is_set():
                    self._drawn = True
                    _write(f"{CLEAR}{line(turn, self.share, self.what, silent_s)}")

    def _clear(self) -> None:
        if self._drawn:
            self._drawn = False
            _write(CLEAR)


def line(turn: int, share: float | None, what: str, seconds: float) -> str:
    """One line: a bar (to and fro where no share is known), what is being done, for how long."""
    if compiles():
        share, what = None, f"{what}; first time here: compiling, once per machine"
    if share is None:
        at = abs(turn % (2 * WIDTH - 6) - (WIDTH - 3))
        bar = " " * at + "=" * 3 + " " * (WIDTH - 3 - at)
    else:
        bar = ("=" * round(WIDTH * min(max(share, 0.0), 1.0))).ljust(WIDTH)
    return f"[{bar}] {printable(what)}, {seconds:.0f} s"


_watched: list[Waiting] = []
"""The command that runs; of one that is called by another, both."""


@contextmanager
def watched() -> Iterator[None]:
    """The block is a command: where it is silent for a second, that it works is shown."""
    if not sys.stderr.isatty():
        yield
        return
    waiting = Waiting()
    _watched.append(waiting)
    waiting.begin()
    try:
        yield
    finally:
        waiting.end()
        _watched.remove(waiting)


def spoken() -> None:
    """Call before anything is printed."""
    for waiting in _watched:
        waiting.interrupt()


def own_terminal() -> None:
    """The command that runs draws, or asks, by itself: nothing more is shown of its silence."""
    for waiting in _watched:
        waiting.end()


@contextmanager
def shown(first: str) -> Iterator[Callable[[float, str], None]]:
    """Within the block, call what is yielded with (share done, what is being done)."""

    def show(share: float, what: str) -> None:
        _tell({"share": share if share >= 0.0 else None, "stage": what})
        for waiting in _watched:
            if share >= 0.0:  # less: no further than before
                waiting.share = share
            waiting.what = what

    show(-1.0, first)
    yield show


def tell_found(text: str) -> None:
    """What the command has found, in a line, for a program that waits for it."""
    _tell({"found": text})


def _tell(what: dict[str, Any]) -> None:
    path = os.environ.get(TOLD)
    if path:
        with suppress(OSError):  # nobody waits any more
            write_whole(Path(path), json.dumps(what))


def _write(text: str) -> None:
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except (OSError, ValueError):  # the terminal is gone
        pass
