"""The console of a craft: text that comes in pieces, as lines, and no more than a person reads."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

LINE_CHARACTERS = 200
"""A longer line is told in parts of so many; the firmware's own are shorter than a hundred."""
LINES_A_SECOND, LINES_AT_ONCE = 20, 200
"""What a craft may say for long, and when it starts. What is beyond that is counted."""
TOLD_EVERY_S = 5.0
"""How often it is told how many lines were left out."""


class Console:
    """Lines of a craft's console, kept until they are taken: ``LINES_AT_ONCE`` at most.

    clock: monotonic, seconds. May be fed from another thread than the one that takes.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._begun = ""  # a line whose end has not come
        self._kept: deque[str] = deque()
        self._dropped = 0
        self._allowed, self._allowed_s = float(LINES_AT_ONCE), clock()
        self._told_s = -TOLD_EVERY_S

    def feed(self, text: str) -> None:
        """Text as it comes; the time this takes grows with its length alone."""
        with self._lock:
            *lines, self._begun = (self._begun + text).split("\n")
            whole = len(self._begun) // LINE_CHARACTERS * LINE_CHARACTERS
            lines.append(self._begun[:whole])
            self._begun = self._begun[whole:]
            for line in filter(None, map(str.strip, lines)):
                for at in range(0, len(line), LINE_CHARACTERS):
                    self._keep(line[at : at + LINE_CHARACTERS])

    def end(self) -> None:
        """The connection has ended: what came of a line is one."""
        self.feed("\n")

    def take(self) -> list[str]:
        """What came since the last call, and how many lines were dropped."""
        with self._lock:
            lines = list(self._kept)
            self._kept.clear()
            if self._dropped and self._clock() >= self._told_s + TOLD_EVERY_S:
                lines.append(f"({self._dropped} lines left out: over {LINES_A_SECOND} a second)")
                self._dropped, self._told_s = 0, self._clock()
            return lines

    def _keep(self, line: str) -> None:
        if len(self._kept) < LINES_AT_ONCE and self._is_allowed():
            self._kept.append(line)
        else:
            self._dropped += 1

    def _is_allowed(self) -> bool:
        """Whether one line more may be told now; it then counts."""
        now_s = self._clock()
        more = LINES_A_SECOND * (now_s - self._allowed_s)
        self._allowed, self._allowed_s = min(self._allowed + more, LINES_AT_ONCE), now_s
        if self._allowed < 1.0:
            return False
        self._allowed -= 1.0
        return True
