"""Flights of ``learn``: the software craft in fast time, or the daemon's craft."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from groundstation import BadInputError, GroundStationError, Pilot, socket_path
from groundstation.cli.commanding import (
    await_connection,
    require_height,
    require_place,
    require_ready,
)
from groundstation.cli.craft_flight import (
    Changes,
    commanded,
    fly_recorded,
    require_calm,
    write_parameters,
)
from groundstation.cli.height_flight import Flyable, Room, fly_by_height
from groundstation.cli.interrupts import Interrupts
from groundstation.cli.learn_take_off import await_battery, await_take_off
from groundstation.cli.stored_gains import clear_gains, require_storing, store_gains
from groundstation.cli.terminal import say
from groundstation.control.programme import BY_HAND
from groundstation.learn.planning import Craft, Flown
from groundstation.paths import written_whole
from groundstation.service.lease import BY_OPERATOR, LANDED_BY_OPERATOR

if TYPE_CHECKING:
    from groundstation.links.software_craft import SoftwareCraft

CLIENT = "learn"
SOFTWARE = "software:"


@dataclass(frozen=True, slots=True)
class Says:
    """What a craft says before anything turns. vehicle: the profile. battery_v: None where it does
    not say. software: nobody can be hurt by it."""

    craft: Craft
    vehicle: str
    battery_v: float | None
    software: bool


@dataclass(frozen=True, slots=True)
class FastPlace:
    """Flies a software craft on its own clock. source: of its settings. model: a file that it flies
    in the place of its own physics; it trims and drifts as its own filter makes it."""

    source: str
    height_m: float
    reach_m: float
    model: str = ""

    def fly(
        self,
        programme: Flyable,
        file: Path,
        *,
        seed: int,
        gains: Mapping[str, float] | None = None,
    ) -> Flown:
        """Fly a programme and leave its recording in ``file``.

        gains: written before it, and put back after it. Raises KeyboardInterrupt when the motors
        stand and what was flown is in the file.
        """
        craft = self._craft(seed)
        room = Room(self.height_m, 0.0, self.reach_m)
        with Interrupts() as signals:
            try:
                craft.arm()
                craft.write(dict(gains or {}))
                flying = _controllers(craft.parameters())
                ended = fly_by_height(
                    craft, programme, room, signals, tells_battery=True, clock=craft
                )
            finally:
                craft.stop()
                craft.save(file)
        if ended.interrupted is not None:
            raise ended.interrupted
        return Flown(ended.why, craft.now_s(), flying)

    def write(self, gains: Mapping[str, float]) -> None:
        """It is switched off between flights and keeps nothing."""

    def require_storing(self) -> None:
        """Raises BadInputError."""
        raise BadInputError(
            f"--store: {self.source} is made anew for each flight: it keeps nothing"
        )

    def store(self, gains: Mapping[str, float]) -> list[str]:
        """It keeps nothing."""
        return []

    def await_battery(self) -> None:
        """It has a full one in each flight."""

    def says(self) -> Says:
        """Raises BadInputError where it cannot fly."""
        craft = self._craft(0)
        return Says(Craft(**craft.lease["craft"]), craft.vehicle.name, None, software=True)

    def _craft(self, seed: int) -> SoftwareCraft:
        from groundstation.links.software_craft import SoftwareCraft

        flies: dict[str, Any] = {}
        if self.model:
            flies = {"plant": "model", "craft": self.model, "effects": {}, "estimated": True}
        return SoftwareCraft(self.source, CLIENT, seed=seed, **flies)


@dataclass(slots=True)
class DaemonPlace:
    """Flies the daemon's craft. stops: the daemon's count of Stops when this program began. told:
    given what a person must know before a take-off. craft: the one that is flown, None before it is
    known."""

    height_m: float
    reach_m: float
    stops: int
    told: Callable[[str], None]
    craft: Craft | None = None

    def fly(
        self,
        programme: Flyable,
        file: Path,
        *,
        seed: int,
        gains: Mapping[str, float] | None = None,
    ) -> Flown:
        """As ``FastPlace.fly``, once the craft stands and a countdown is over. Raises
        GroundStationError where the motors were stopped since this program began, or another craft
        is there."""
        await_connection(socket_path())
        require_calm(self.stops)
        with self._commanded() as pilot:
            ready = require_ready(pilot, needs_battery=False, may_be_disarmed=True)
            tells = ready["battery_v"] is not None
            _require_holding(pilot)
            changes = Changes.of(pilot.parameters(), gains or {})
            floor_m = await_take_off(pilot, file.name, self.told)
            self.told(f"flying {file.name}. Ctrl-C lands it.")
            room = Room(self.height_m, floor_m, self.reach_m)
            flying = _controllers(pilot.parameters()) | changes.changed
            report = fly_recorded(
                pilot,
                changes,
                lambda signals: fly_by_height(pilot, programme, room, signals, tells_battery=tells),
                f"{CLIENT} begins",
                purpose=file.name,
            )
        say(report.ended.motors, error=True)
        _copied(Path(report.recording), file)
        if report.ended.interrupted is not None:
            raise report.ended.interrupted
        why = report.ended.why
        by_hand = why in (BY_OPERATOR, LANDED_BY_OPERATOR)
        return Flown(f"{BY_HAND}: {why}" if by_hand else why, report.seconds, flying)

    def write(self, gains: Mapping[str, float]) -> None:
        """Write gains that stay to a craft that stands."""
        with self._commanded() as pilot:
            write_parameters(pilot, gains)

    def require_storing(self) -> None:
        """Raises BadInputError for a craft that forgets its gains when it is switched off."""
        with self._commanded() as pilot:
            require_storing(pilot)

    def store(self, gains: Mapping[str, float]) -> list[str]:
        """Write gains that flew well to a craft that stands, and have it keep them; the names of
        what it has stored."""
        with self._commanded() as pilot:
            write_parameters(pilot, gains)
            return store_gains(pilot, "the craft is learnt")

    def put_back(self, former: Mapping[str, float]) -> list[str]:
        """Write former gains, and clear stored ones; the names of the latter."""
        with self._commanded() as pilot:
            write_parameters(pilot, former)
            return sorted(clear_gains(pilot))

    def await_battery(self) -> None:
        """Wait for the craft with a full battery. Raises GroundStationError where none comes, or
        where it does not tell its voltage."""
        await_battery(self._commanded, lambda: require_calm(self.stops))

    def says(self) -> Says:
        """Raises GroundStationError where it cannot fly."""
        path = socket_path()
        await_connection(path)
        with self._commanded() as pilot:
            _require_holding(pilot)
            ready = require_ready(pilot, needs_battery=False, may_be_disarmed=True)
            vehicle = pilot.ask("GET", "/status")["vehicle"]
            lease = pilot.lease
        return Says(Craft(**lease["craft"]), vehicle, ready["battery_v"], lease["software"])

    def _commanded(self) -> Any:
        return commanded(CLIENT, self.stops, self.craft)


Place = FastPlace | DaemonPlace


def _require_holding(pilot: Pilot) -> None:
    require_height(pilot)
    require_place(pilot)


def _controllers(parameters: Mapping[str, float]) -> dict[str, float]:
    return {k: v for k, v in parameters.items() if k.startswith("pid_")}


def _copied(recording: Path, file: Path) -> None:
    """The daemon's recording in the folder of what is learnt, whole or not at all."""
    try:
        with recording.open("rb") as source, written_whole(file) as target:
            shutil.copyfileobj(source, target)
    except OSError as error:
        raise GroundStationError(
            f"{file}: cannot be written: {error.strerror}; the flight is in {recording}"
        ) from error
