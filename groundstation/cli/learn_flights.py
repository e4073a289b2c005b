"""Flights of ``learn``: one pilot for the software craft in fast time and a craft behind the
daemon."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from groundstation import GroundStationError, Pilot, socket_path
from groundstation.cli.commanding import (
    await_connection,
    begin_recording,
    end_recording,
    patient,
    require_height,
    require_ready,
)
from groundstation.cli.craft_parameters import (
    put_back,
    put_back_left,
    why_aborted,
    write_parameters,
)
from groundstation.cli.left_changed import also_written, note_changes
from groundstation.cli.pid_manoeuvres import Flyable, fly_programme, stop_motors
from groundstation.cli.sticks import CraftHeight, Hands
from groundstation.cli.terminal import say
from groundstation.control.programme import BY_HAND, GRAVITY
from groundstation.learn.journal import Flown
from groundstation.service.motor_stop import BY_OPERATOR

if TYPE_CHECKING:
    from groundstation.links.software_craft import SoftwareCraft

CLIENT = "learn"
SOFTWARE = "software:"
LEAN_PER_M, LEAN_PER_M_S, LEAN_MOST_DEG = 5.8, 9.3, 10.0
"""Of the onlooker who keeps a craft in its place."""
LIFT_PER_M, LIFT_PER_M_S, LIFT_PER_M_SECOND = 4.0, 3.6, 1.5
"""And of his thrust: accelerations, m/s^2."""
TICK_S = 0.01
FULL_V, CHANGED_S = 4.0, 600.0
"""A full cell at rest, and how long one is waited for."""
CLEAR_S, STILL_DPS = 15.0, 5.0
"""Whoever changed it needs time to step back: the craft has to stand still for so long, turning no
faster than this."""
HOVERS = 36000.0
"""16-bit thrust that he begins with."""


class Onlooker(CraftHeight):
    """Somebody who watches the software craft: leans it back to its place, and gives the thrust
    where it does not hold its height by itself. places: whether he leans."""

    def __init__(self, craft: SoftwareCraft, height_m: float, *, places: bool) -> None:
        super().__init__(height_m, 0.0, craft.now_s)
        self._craft, self._places = craft, places
        self._seen, self._lift, self._climb = craft.position_m, 0.0, 0.0

    def at(self, height_m: float) -> Hands:
        now = self._craft.position_m
        ahead, aside, climb = ((a - b) / TICK_S for a, b in zip(now, self._seen, strict=True))
        self._seen = now
        roll = pitch = 0.0
        if self._places:
            turn = self._craft.heading_rad
            x, y = (LEAN_PER_M * p + LEAN_PER_M_S * v
                    for p, v in zip(now[:2], (ahead, aside), strict=True))  # fmt: skip
            pitch = -_within(math.cos(turn) * x + math.sin(turn) * y, LEAN_MOST_DEG)
            roll = _within(-math.sin(turn) * x + math.cos(turn) * y, LEAN_MOST_DEG)
        hands = Hands(roll_deg=roll, pitch_deg=pitch)
        if self._craft.lease["holds_height"]:
            return replace(hands, height_m=max(height_m, 0.0))
        error = height_m - now[2]
        self._lift = _within(self._lift + LIFT_PER_M_SECOND * error * TICK_S, 4.0)
        push = LIFT_PER_M * error - LIFT_PER_M_S * climb + self._lift
        ratio = min(max(1.0 + push / GRAVITY, 0.3), 1.6)
        return replace(hands, thrust=round(HOVERS * ratio ** (1.0 / 1.7)))


def _copied(recording: Path, file: Path) -> None:
    """The daemon's recording in the folder of what is learnt, whole or not at all."""
    try:
        file.write_bytes(recording.read_bytes())
    except OSError as error:
        file.unlink(missing_ok=True)
        raise GroundStationError(
            f"{file}: cannot be written: {error.strerror}; the flight is in {recording}"
        ) from error


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)


@dataclass(frozen=True, slots=True)
class Place:
    """Where flights are flown. link: ``software:SETTINGS`` or ``daemon``. height_m: held. model: a
    file that the software craft flies in the place of its own physics."""

    link: str
    height_m: float
    model: str = ""

    @property
    def is_software(self) -> bool:
        return self.link.startswith(SOFTWARE)

    def fly(
        self,
        programme: Flyable,
        file: Path,
        *,
        seed: int,
        gains: Mapping[str, float] | None = None,
        steps: bool = False,
    ) -> Flown:
        """Fly a programme and leave its recording in ``file``.

        steps: nobody but the programme leans it. gains: written before it, and put back after it.
        Raises KeyboardInterrupt when the motors stand and what was flown is in the file.
        """
        if self.is_software:
            return self._fast(programme, file, seed, dict(gains or {}), steps)
        return self._real(programme, file, dict(gains or {}))

    def write(self, gains: Mapping[str, float]) -> None:
        """Write gains to a craft that stands; a software craft is switched off between flights."""
        if not self.is_software:
            with Pilot(socket_path(), CLIENT) as pilot:
                pilot.write(dict(gains))

    def await_battery(self) -> None:
        """Wait for a craft with a full battery that stands still; a software craft has one. Raises
        GroundStationError where none comes, or where it does not tell its voltage."""
        now = time.monotonic()
        deadline, still = now + CHANGED_S, now
        while not self.is_software and time.monotonic() - still < CLEAR_S:
            full = False
            with contextlib.suppress(GroundStationError), Pilot(socket_path(), CLIENT) as pilot:
                telemetry = require_ready(pilot, needs_battery=True)
                turning = max(abs(rate) for rate in telemetry["gyro_dps"])
                full = telemetry["battery_v"] >= FULL_V and turning < STILL_DPS
            if not full:
                still = time.monotonic()
            if time.monotonic() > deadline:
                raise GroundStationError(
                    f"no craft with a battery of {FULL_V:g} V and more that stood still for"
                    f" {CLEAR_S:g} s came within {CHANGED_S / 60:.0f} min; put a full one in, and"
                    " the same command goes on"
                )
            time.sleep(1.0)

    def says(self) -> dict[str, Any]:
        """What the craft says before anything turns: ``craft``, ``vehicle``, ``firmware``,
        ``battery_v``. Raises GroundStationError where it cannot fly."""
        if self.is_software:
            craft = self._craft(0)
            return {"craft": craft.uri, "vehicle": craft.vehicle.name,
                    "firmware": craft.lease["firmware"], "battery_v": None}  # fmt: skip
        path = socket_path()
        await_connection(path)
        with Pilot(path, CLIENT) as pilot:
            require_height(pilot)
            telemetry = require_ready(pilot, needs_battery=False)
            return {"craft": pilot.lease["uri"], "vehicle": pilot.ask("GET", "/status")["vehicle"],
                    "firmware": pilot.lease["firmware"],
                    "battery_v": telemetry["battery_v"]}  # fmt: skip

    def _craft(self, seed: int) -> SoftwareCraft:
        from groundstation.links.software_craft import SoftwareCraft

        flies = {"plant": "model", "craft": self.model, "effects": {}} if self.model else {}
        return SoftwareCraft(self.link.removeprefix(SOFTWARE), CLIENT, seed=seed, **flies)

    def _fast(
        self,
        programme: Flyable,
        file: Path,
        seed: int,
        gains: dict[str, float],
        steps: bool,
    ) -> Flown:
        craft = self._craft(seed)
        try:
            craft.arm()
            craft.write(gains)
            flying = {k: v for k, v in craft.parameters().items() if k.startswith("pid_")}
            sticks = Onlooker(craft, self.height_m, places=not steps)
            aborted = fly_programme(craft, programme, sticks, tells_battery=True, clock=craft)
        finally:
            craft.stop()
            craft.save(file)
        return Flown(aborted, craft.now_s(), flying)

    def _real(self, programme: Flyable, file: Path, gains: dict[str, float]) -> Flown:
        path = socket_path()
        await_connection(path)
        with Pilot(path, CLIENT) as pilot:
            tells = require_ready(pilot, needs_battery=False)["battery_v"] is not None
            require_height(pilot)
            before = pilot.parameters()
            before |= put_back_left(pilot, before)
            saved = {name: before[name] for name in gains}
            floor_m = pilot.setpoint(0.0, 0.0, 0.0, 0)["height_m"] or 0.0
            recording = begin_recording(path)
            aborted, begun_s = "interrupted", time.monotonic()
            try:
                if gains:  # `pid fly --undo` puts back what a killed program leaves
                    note_changes(pilot.lease["uri"], saved, also_written({}, gains))
                    write_parameters(pilot, gains)
                sticks = CraftHeight(self.height_m, floor_m)
                aborted = fly_programme(pilot, programme, sticks, tells_battery=tells)
            except GroundStationError as error:
                aborted = why_aborted(error)
            finally:
                seconds = time.monotonic() - begun_s
                with patient():
                    told = stop_motors(pilot)
                    say(told, error=True)
                    flown = end_recording(path, recording, aborted)
                    put_back(pilot, CLIENT, saved, {}, {}, aborted)
                    _copied(Path(flown), file)
        flying = {k: v for k, v in before.items() if k.startswith("pid_")} | gains
        if aborted == BY_OPERATOR:
            aborted = f"{BY_HAND}: {aborted}"
        return Flown(aborted, seconds, flying)
