"""Ctrl-C and SIGTERM of a program that has a craft in the air."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType
from typing import Any, Self

from groundstation.cli.terminal import say


class Interrupts:
    """Raise KeyboardInterrupt inside ``heard`` alone: what comes between two of its blocks is
    raised at the beginning of the next one, so that nothing skips a landing."""

    def __init__(self) -> None:
        self.came = 0
        """How many there were so far."""
        self._pending = ""
        self._listens = False
        self._spare, self._told = 0, ""
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextlib.contextmanager
    def heard(self, spare: int = 0, told: str = "") -> Iterator[None]:
        """Within this an interrupt raises KeyboardInterrupt, after ``spare`` of them that are only
        answered with ``told``."""
        self._spare, self._told, self._listens = spare, told, True
        try:
            if self._pending:
                self._meet(self._pending)
            yield
        finally:
            self._listens = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.came += 1
        name = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        if self._listens:
            self._meet(name)
        else:
            self._pending = name

    def _meet(self, name: str) -> None:
        self._pending = ""
        if self._spare > 0:
            self._spare -= 1
            say(self._told, error=True)
            return
        self._listens = False
        raise KeyboardInterrupt(name)
