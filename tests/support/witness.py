"""What happens to crafts, written down, and what of it should not have been."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable

from support.begun import Begun
from support.truth import Craft, Flight
from support.waiting import HELD_UP_S, Watch

BY_OPERATOR = "the operator "
"""How the event of a Stop and of a Land begins; a client's own is none."""
SINK_M_S, CLIMBING_M, CLIMBING_M_S = 0.8, 0.25, 1.0
"""A landing goes down with 0.3 m/s; falling from the height that is flown here ends at 2.4 m/s. One
that begins in a take-off, before the second height, may end at the third speed: a Brushless climbs
on to 0.2 m, and sinks from there with 0.85 m/s; falling, it is 2 m/s."""
READS_S = 1.0
"""Python itself takes so long to start on a busy machine: until then a program was not begun."""
BEFORE_S = 1.0
"""What ends a flight may have been done so long before its rotors began."""
counted: Counter[str] = Counter()
"""How often it happened, of all there was."""


class Witness:
    """crafts: whose truth is looked at. craft: the one in reach. said: what was done, in order.
    hard: when what may drop a craft was done, and what. begun: who may have asked for the lease.
    heard_ns: the newest event that was looked at. steers: process ids of what must not stand still
    for a flight to be landed, beside this one, which is the craft."""

    def __init__(self, crafts: list[Craft], steers: Callable[[], list[int]]) -> None:
        self.begun_s = time.monotonic()
        self.crafts, self.craft = crafts, crafts[0]
        self.said: list[str] = []
        self.hard: list[tuple[float, str]] = []
        self.begun: list[Begun] = []
        self.heard_ns = 0
        self.watch = Watch(lambda: [os.getpid(), *steers()])
        self.watch.__enter__()
        self._judged = dict.fromkeys(map(id, crafts), 0)

    def say(self, text: str) -> None:
        self.said.append(f"{time.monotonic() - self.begun_s:6.2f} s  {text}")

    def drops(self, what: str) -> None:
        """Whatever flies now may fall."""
        self.hard.append((time.monotonic(), what))
        self._count(what)

    def soft(self, what: str) -> None:
        """Whatever flies now lands."""
        self._count(what)

    def _count(self, what: str) -> None:
        where = " in the air" if self.craft.truth.flies else ""
        self.say(what + where)
        counted[f"{what.partition(' for ')[0]}{where}"] += 1

    def of_flights(self) -> list[str]:
        """What was wrong with rotors, and with the touch-downs that were not looked at yet."""
        found = []
        for craft in self.crafts:
            found += craft.truth.faults
            for flight in craft.truth.flights[self._judged[id(craft)] :]:
                if flight.ended_s:
                    self._judged[id(craft)] += 1
                    found += self._judge(flight)
        return found

    def _judge(self, flight: Flight) -> list[str]:
        counted["flights"] += 1
        begun_s = flight.begun_s - BEFORE_S
        hard = [what for at_s, what in self.hard if begun_s <= at_s <= flight.ended_s]
        self.say(f"met the floor with {flight.sink_m_s:.2f} m/s from {flight.highest_m:.2f} m")
        if hard:
            counted["may fall"] += 1
            counted["fell"] += flight.sink_m_s > SINK_M_S
            return []
        most_m_s = SINK_M_S if flight.highest_m > CLIMBING_M else CLIMBING_M_S
        if flight.sink_m_s > most_m_s:
            held_s, who = self.watch.longest()
            if held_s >= HELD_UP_S:
                self.say(f"not judged: the machine held {who} up for {held_s:.2f} s")
                counted["not judged"] += 1
                return []
            return [f"dropped: met the floor with {flight.sink_m_s:.2f} m/s"]
        counted["landings"] += 1
        return []

    def of_leases(self, events: list[dict]) -> list[str]:
        """Whoever got the lease after a stop was begun after it."""
        found, stop_ns = [], 0
        for event in events:
            if event["kind"] == "stop" and event["text"].startswith(BY_OPERATOR):
                stop_ns = event["time_ns"]
            who, commands, _ = event["text"].partition(" commands now")
            if not commands or event["time_ns"] <= self.heard_ns:
                continue
            self.heard_ns = event["time_ns"]
            counted["leases"] += 1
            kinds = {"learn": ("learn", "job")}.get(who, (who,))
            last_ns = max((one.begun_ns for one in self.begun if one.name in kinds), default=0)
            if last_ns < stop_ns - READS_S * 1e9:
                after_s = (event["time_ns"] - stop_ns) * 1e-9
                found.append(f"{who} got the lease {after_s:.2f} s after a stop")
        return found
