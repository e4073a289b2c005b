"""What a craft in this process really does, looked at after each of its steps of 10 ms."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field

from firmware_sim.craft import StandIn
from firmware_sim.craft_state import CraftState
from firmware_sim.physics import PARAMETER_NAMES
from firmware_sim.settings import StandInSettings
from support.crafts import ServedCraft

AIR_M, FLOOR_M = 0.05, 0.01
"""Higher than the first it flies, lower than the second after it, it has touched down."""
TESTED_MS = 4000
"""The firmware tests its motors when it is switched on: each turns for a moment."""
BEFORE_S = 0.1
"""The speed at a touch-down is the largest of so long before it: the floor has changed the last."""


@dataclass(slots=True)
class Flight:
    """From the floor to the floor. begun_s: when its rotors began, of the monotonic clock.
    sink_m_s, aside_m_s: down and sideways at the touch-down. ended_s: when that was, or 0."""

    begun_s: float
    highest_m: float = 0.0
    sink_m_s: float = 0.0
    aside_m_s: float = 0.0
    ended_s: float = 0.0


@dataclass(slots=True)
class Truth:
    """quiet_since_s: a person was told so that the motors stand, and nobody asked for them since;
    None: somebody may. faults: what should never have been."""

    flights: list[Flight] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    turns: bool = False
    height_m: float = 0.0
    turned: int = 0
    quiet_since_s: float | None = None
    _rotors_s: float = 0.0
    _before: list[CraftState] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def of(self, served: ServedCraft) -> Truth:
        """Look at this one from now on."""
        self._before.clear()
        if self.flights and not self.flights[-1].ended_s:
            self.flights.pop()  # another craft: nobody sees the end of that flight
        self.turns, self.height_m = False, 0.0
        served.each_step = lambda: self._look(served.craft.state())
        return self

    @property
    def flies(self) -> bool:
        return bool(self.flights) and not self.flights[-1].ended_s

    def be_quiet(self) -> None:
        """The motors were said to stand."""
        with self._lock:
            self.quiet_since_s = time.monotonic()

    def may_turn(self) -> None:
        """A person asks for something that may turn the rotors."""
        with self._lock:
            self.quiet_since_s = None

    def _look(self, state: CraftState) -> None:
        now_s, turns = time.monotonic(), any(state.motors) and state.uptime_ms > TESTED_MS
        with self._lock:
            if turns and not self.turns:
                self._rotors_s = now_s
                self.turned += 1
            if turns and self.quiet_since_s is not None:
                after_s = now_s - self.quiet_since_s
                self.faults.append(f"rotors turn {after_s:.2f} s after they were said to stand")
                self.quiet_since_s = None
        self.turns, self.height_m = turns, state.position_m[2]
        self._before.append(state)
        while state.time_s - self._before[0].time_s > BEFORE_S:
            self._before.pop(0)
        self._follow(now_s)

    def _follow(self, now_s: float) -> None:
        if not self.flies:
            if self.height_m > AIR_M:
                self.flights.append(Flight(self._rotors_s))
            return
        flight = self.flights[-1]
        flight.highest_m = max(flight.highest_m, self.height_m)
        if self.height_m < FLOOR_M:
            last = min(self._before, key=lambda one: one.velocity_m_s[2])
            ahead, left, up = last.velocity_m_s
            flight.sink_m_s, flight.aside_m_s = -up, (ahead**2 + left**2) ** 0.5
            flight.ended_s = now_s


class Craft:
    """One with a Flow deck, and its truth. gains: name -> what it may have when all is over."""

    def __init__(self, vehicle: str, seed: int) -> None:
        self.vehicle = vehicle
        self._settings = StandInSettings(
            craft=vehicle, plant="reduced", flow_deck=True, program="wait", resume_s=1e6,
            recharge_s=1e6, seed=seed,
        )  # fmt: skip
        self.truth = Truth()
        self.served: ServedCraft | None = None
        self.switched = 0
        self.gains: dict[str, set[float]] = {}

    def switch_on(self, booted: bool = False) -> None:
        """Off before, where it is on; what it was told is forgotten. booted: long ago."""
        self.switch_off()
        craft = StandIn(self._settings)
        craft.advance(3.0 if booted else 0.0)
        self.gains = {name: {craft.get_parameter(name)} for name in PARAMETER_NAMES}
        self.served = ServedCraft(craft)
        self.truth.of(self.served)
        self.served.start()
        self.switched += 1

    def switch_off(self) -> None:
        if self.served is not None:
            self.served.stop()
            self.served = None

    @property
    def craft(self) -> StandIn:
        assert self.served is not None
        return self.served.craft

    def drain(self) -> None:
        """Its cell is nearly empty from now on: no command does that."""
        with self.craft._lock:
            self.craft._state[0]["charge"] = 0.04
