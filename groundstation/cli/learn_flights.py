"""Flights of ``learn``: on the software craft in fast time, or on the daemon's craft."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation import BadInputError, GroundStationError, Pilot, load_model, socket_path
from groundstation.cli.flying import (
    LOOK_S,
    Changes,
    Flyable,
    Interrupts,
    Room,
    await_connection,
    clear_gains,
    commanded,
    fly_by_height,
    fly_recorded,
    require_calm,
    require_height,
    require_place,
    require_ready,
    require_storing,
    store_gains,
    write_parameters,
)
from groundstation.cli.terminal import say
from groundstation.control.programme import BY_HAND, Standing, trouble_of
from groundstation.control.step_analysis import analyse_recording
from groundstation.learn.planning import Craft, Flown
from groundstation.links.command import NOT_ARMED, PLACE
from groundstation.paths import written_whole
from groundstation.recording.formats import open_for_analysis
from groundstation.service.lease import BY_OPERATOR, LANDED_BY_OPERATOR

if TYPE_CHECKING:
    from groundstation.control.step_analysis import Flown as FlownSteps
    from groundstation.links.software_craft import SoftwareCraft
    from groundstation.recording.session import Recording

# Before each take-off of ``learn``: a craft that stands, a full battery, a countdown.


WAIT_S = 600.0
"""How long a craft that stands, or a full battery, is waited for."""
COUNTDOWN_S = 10
"""From the announcement to the take-off: enough to step back, or to press Stop."""
FULL_V, CLEAR_S = 4.0, 15.0
"""A full cell at rest, and how long the craft must stand still: whoever changed it needs time to
step back."""


def await_take_off(pilot: Pilot, flight: str, told: Callable[[str], None]) -> float:
    """Wait for a craft that stands still, level and on the floor, count down, and give its own
    height there, m. Raises GroundStationError where none stands within ``WAIT_S``.

    told: given each reason to wait once, and the countdown.
    """
    deadline, said = time.monotonic() + WAIT_S, set[str]()
    while True:
        _await_standing(pilot, deadline, said, told)
        told(f"{flight}: take-off in {COUNTDOWN_S} s. Ctrl-C cancels.")
        pilot.announce(f"learn: take-off for {flight}", COUNTDOWN_S)
        until = time.monotonic() + COUNTDOWN_S
        while time.monotonic() < until:
            answer = pilot.setpoint(0.0, 0.0, 0.0, 0)
            if trouble_of(answer):
                pilot.announce("take-off cancelled", 0.0)
                told("take-off cancelled: the craft does not stand still any more")
                break
            time.sleep(LOOK_S)
        else:
            return float(answer["height_m"] or 0.0)


def _await_standing(
    pilot: Pilot, deadline: float, said: set[str], told: Callable[[str], None]
) -> None:
    standing = Standing()
    while not standing.look(time.monotonic(), pilot.setpoint(0.0, 0.0, 0.0, 0)):
        why = standing.trouble
        kind = why.partition("(")[0].partition(" by ")[0]
        if why and kind not in said:
            said.add(kind)
            told(f"waiting for the craft: {why}")
        if time.monotonic() > deadline:
            raise GroundStationError(
                f"the craft did not stand ready within {WAIT_S / 60:.0f} min"
                f"{': ' + why if why else ''}; the same command goes on"
            )
        time.sleep(LOOK_S)


def await_battery(
    commanded: Callable[[], AbstractContextManager[Pilot]], require_calm: Callable[[], None]
) -> None:
    """Wait for a craft with a full battery that stands still. Raises GroundStationError where none
    comes within ``WAIT_S``, or as ``require_calm`` does.

    commanded: the lease on the craft, anew each time, for it is switched off meanwhile.
    """
    still = time.monotonic()
    deadline = still + WAIT_S
    while time.monotonic() - still < CLEAR_S:
        require_calm()
        full = False
        with contextlib.suppress(GroundStationError), commanded() as pilot:
            telemetry = require_ready(pilot, needs_battery=True, may_be_disarmed=True)
            stands = trouble_of(pilot.setpoint(0.0, 0.0, 0.0, 0)) in ("", NOT_ARMED)
            full = telemetry["battery_v"] >= FULL_V and stands
        if not full:
            still = time.monotonic()
        if time.monotonic() > deadline:
            raise GroundStationError(
                f"no craft with a battery of {FULL_V:g} V and more that stood still for"
                f" {CLEAR_S:g} s came within {WAIT_S / 60:.0f} min; put a full one in, and"
                " the same command goes on"
            )
        time.sleep(1.0)


# Flights of ``learn``: the software craft in fast time, or the daemon's craft.


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


# A programme with its gains on the software craft with an identified model, before a real craft
# flies it: its trims, its drift and its thrust curve are the craft's.


SEED = 1
"""Of the noise that it flies in."""


def rehearse(
    programme: Flyable,
    gains: Mapping[str, float],
    model: str,
    height_m: float,
    reach_m: float,
    measures: bool,
) -> tuple[dict[str, Any], FlownSteps | None]:
    """What became of it: seconds, how far it went, how fast, how it leaned; and its steps.

    gains: over the stock ones. measures: whether its steps are measured as well. Raises
    GroundStationError where it did not stay in its room, or did not fly at all.
    """
    loaded = load_model(model)
    place = FastPlace(loaded.vehicle, height_m, reach_m, model)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rehearsal.mcap"
        flown = place.fly(programme, file, seed=SEED, gains=gains)
        if flown.aborted:
            raise GroundStationError(
                f"rehearsed in software: the model does not fly this to its end: {flown.aborted};"
                " no craft was touched"
            )
        recording = open_for_analysis(file)
        steps = None
        if measures:
            with contextlib.suppress(BadInputError):  # where it was brought back in its steps
                steps = analyse_recording(recording, loaded, flown.gains, CLIENT)
    return {"seconds": flown.seconds, **_room_of(recording)}, steps


def _room_of(recording: Recording) -> dict[str, float]:
    table = next(iter(recording.tables.values()))
    x, y, _, vx, vy, _ = (np.asarray(table.columns[name], np.float64) for name in PLACE)
    return {
        "farthest_m": float(np.hypot(x, y).max()),
        "top_m_s": float(np.hypot(vx, vy).max()),
        "lean_deg": float(np.degrees(np.abs(recording.samples.attitude[:, :2]).max())),
    }
