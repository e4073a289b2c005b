"""What happened: events of links, clients and the daemon itself, kept, logged and handed on."""

from __future__ import annotations

import heapq
import itertools
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from operator import itemgetter

from groundstation.links.command import HostClock, LinkEvent
from groundstation.service.twin import BEGAN
from groundstation.text import printable

EVENTS_KEPT = 1000
_WARNINGS = frozenset(
    {
        "fault",
        "lost",
        "loss",
        "silent",
        "waiting",
        "restart",
        "damage",
        "dead man",
        "stop",
        "landing",
        "restore",
        "deleted",
        "held up",
        BEGAN,
    }
)


class Journal:
    """The daemon's events.

    clock: stamps events of the daemon itself. is_repetition: whether an event of (source, kind) is
    no news. listeners: handed every other event; log: as well, with whether it is a warning.
    """

    def __init__(self, clock: HostClock, is_repetition: Callable[[str, str], bool]) -> None:
        self._kept = _Kept(EVENTS_KEPT)
        self.damaged = False
        """Whether the source had parts that could not be read."""
        self.faults = 0
        """Faults of the program itself, each survived and told as an event."""
        self.listeners: list[Callable[[LinkEvent], None]] = []
        self._clock = clock
        self._is_repetition = is_repetition
        self.log: Callable[[LinkEvent, bool], None] = lambda event, warns: None

    @property
    def events(self) -> list[LinkEvent]:
        """The latest, in the order in which they came."""
        return list(self._kept)

    def note(self, kind: str, text: str, *, source: str) -> None:
        """An event of the daemon itself."""
        self.take(LinkEvent(self._clock(), source, kind, text))

    def fault(self, text: str, *, source: str) -> None:
        """A fault of the program that it survives: counted and told."""
        self.faults += 1
        self.note("fault", text, source=source)

    def take(self, event: LinkEvent) -> None:
        """Keep and log an event, and hand it on."""
        event = replace(event, link=printable(event.link), text=printable(event.text))
        if self._is_repetition(event.link, event.kind):
            return
        self._kept.append(event)
        self.damaged |= event.kind == "damage"
        self.log(event, event.kind in _WARNINGS)
        for listener in self.listeners:
            listener(event)


class _Kept:
    """The latest events in order; a flood of one kind pushes out its own.

    most: of all kinds. Beyond it the oldest of the kind that has most is forgotten.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._number = itertools.count()
        self._by_kind: dict[str, deque[tuple[int, LinkEvent]]] = {}

    def append(self, event: LinkEvent) -> None:
        self._by_kind.setdefault(event.kind, deque()).append((next(self._number), event))
        if len(self) > self._most:
            max(self._by_kind.values(), key=len).popleft()

    def __len__(self) -> int:
        return sum(map(len, self._by_kind.values()))

    def __iter__(self) -> Iterator[LinkEvent]:
        return (event for _, event in heapq.merge(*self._by_kind.values(), key=itemgetter(0)))
