"""``learn`` and ``plan``: from a craft to a better craft, and what to fly next by hand."""

from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import typer

from groundstation import BadInputError, GroundStationError, Pilot, socket_path
from groundstation.cli.flying import (
    LOOK_S,
    STORE,
    Flight,
    Flyable,
    Interrupts,
    Room,
    await_connection,
    clear_gains,
    commanded,
    fly_by_height,
    gains_of,
    lets_sink,
    require_calm,
    require_height,
    require_place,
    require_ready,
    require_storing,
    stops_begun,
    store_gains,
    write_parameters,
)
from groundstation.cli.model_files import AS_JSON, answer, fitted_model, require_new
from groundstation.cli.terminal import (
    own_terminal,
    require_yes,
    say,
    show,
    show_json,
    shown,
    tell_found,
)
from groundstation.control.programme import BEYOND_M, BY_HAND, Standing, trouble_of
from groundstation.links.command import NOT_ARMED, PLACE
from groundstation.paths import written_whole
from groundstation.service.client import ask
from groundstation.service.lease import BY_OPERATOR, LANDED_BY_OPERATOR

if TYPE_CHECKING:
    from groundstation.control.step_analysis import Flown as FlownSteps
    from groundstation.learn.planning import Craft, Flown, Journal, Limits, Task
    from groundstation.links.software_craft import SoftwareCraft
    from groundstation.shell import Shell

Told = Callable[[str], None]
CLIENT = "learn"
SOFTWARE = "software:"
CRAFT, SEALED = "craft.toml", "sealed.toml"
HIDDEN_EFFECTS = (2, 3)
HEIGHT = typer.Option(0.5, "--height", help="Height to fly at, m.")
SPACE = typer.Option(
    "2x2", "--space", metavar="WIDTHxDEPTH", help="Room it may use, m; leave more around."
)


def add_commands(app: typer.Typer) -> None:
    app.command("learn")(learn)
    app.command("plan")(plan)


def learn(
    link: str = typer.Option(
        "daemon",
        "--link",
        help="daemon (the running daemon's craft), or software:VEHICLE, software:MODEL.json (an"
        " identified one) or software:FILE.toml, a software craft in fast time.",
    ),
    output: Path = typer.Option(
        Path("learnt"), "-o", "--output", help="Its folder; one that was begun is gone on with."
    ),
    height: float = HEIGHT,
    space: str = SPACE,
    batteries: int = typer.Option(3, "--batteries", min=1, max=20, help="As many at most."),
    seed: int = typer.Option(1, "--seed", min=0, max=10**6, help="Of all that is random."),
    hide: int | None = typer.Option(
        None, "--hide", min=0, max=10**6, help="Hide effects by this seed; told at the end."
    ),
    store: bool = STORE,
    undo: bool = typer.Option(False, "--undo", help="Put former gains back, clear stored ones."),
    yes: bool = typer.Option(False, "--yes", help="Do not ask before a real craft flies."),
    as_json: bool = AS_JSON,
) -> None:
    """Learn a craft: fly what is unknown, name what a model lacks, prove it, design gains, fly
    them.

    A real craft is the running daemon's. It takes off several times by itself, each time after a
    countdown, with minutes of computing in between. Ctrl-C lands it, a second one stops its motors;
    Stop ends this program. Run the same command again to resume.

    Example: [bold]groundstation learn --link software:crazyflie21 --hide 1[/bold]
    """
    from groundstation.learn.planning import Task, journal_in

    own_terminal()
    if not link.startswith(SOFTWARE) and link != "daemon":
        raise BadInputError(
            f"--link {link}: a craft is flown through a running daemon: 'groundstation run --link"
            f" {link}', then learn without --link"
        )
    limits = _limits(height, space)
    journal = journal_in(output)
    if hide is not None and not link.startswith(SOFTWARE):
        raise BadInputError("--hide: only in a software craft, --link software:VEHICLE")
    if undo:
        _undo(journal, output)
        return
    task = Task(
        link=link,
        vehicle="",
        height_m=limits.height_m,
        reach_m=limits.reach_m,
        seed=seed,
        batteries=batteries,
        hide=hide,
    )
    _lead(_begun(journal, task, output), output, limits, yes, store, as_json)


def _lead(
    journal: Journal, output: Path, limits: Limits, yes: bool, store: bool, as_json: bool
) -> None:
    """From wherever the journal is to the report; the folder keeps it, whatever ends this."""
    from groundstation.learn.story import Learner, flights_ahead
    from groundstation.shell import Shell

    link = journal.task.link
    inputs: dict[str, str | None] = {"flight*.mcap": None, "proof.mcap": None}
    if link.startswith(SOFTWARE):
        inputs = {CRAFT: _craft_text(link), **inputs}
        FastPlace(link.partition(":")[2], limits.height_m, limits.reach_m).says()
    begun_s = time.monotonic()

    def told(text: str) -> None:
        show(text, error=as_json)
        flown = sum(not one.aborted for one in journal.flights)
        progress(flown / (flown + flights_ahead(journal, limits)[0]), text)

    def rehearse(model: Path) -> FastPlace:
        plain = shell.folder / CRAFT
        source = str(plain) if plain.exists() else journal.task.vehicle
        return FastPlace(source, limits.height_m, limits.reach_m, str(model))

    with (
        shown("looking at the craft") as progress,
        Shell(output, inputs, lambda line: told(f"  {line}"), "groundstation learn", True) as shell,
    ):
        if link.startswith(SOFTWARE):
            source = str(shell.folder / _sealed(shell, journal.task.hide))
            pilot: Place = FastPlace(source, limits.height_m, limits.reach_m)
        else:
            pilot = _daemon_place(journal, told)
        journal.save(shell.folder)
        _preflight(pilot, journal, limits, yes, store, told)
        try:
            Learner(journal, shell, pilot, rehearse, told).learn()
        finally:
            journal.seconds += time.monotonic() - begun_s
            journal.save(shell.folder)
        _report(journal, shell.folder, as_json, told)
        if store:
            _store(journal, shell.folder, pilot, told)
        tell_found(", ".join(one for one in journal.said if one.startswith(("search", "gains: "))))


def plan(
    model: str = typer.Option(..., "--model", help="Model file: what is known of the craft."),
    seconds: float = typer.Option(45.0, "--seconds", min=7.0, max=300.0, help="Time to fly."),
    output: Path | None = typer.Option(None, "-o", "--output", help="A new JSON file."),
    height: float = HEIGHT,
    space: str = SPACE,
    as_json: bool = AS_JSON,
) -> None:
    """What to fly next: the manoeuvres that tell the most of what a model leaves open.

    Example: [bold]groundstation plan --model body.json[/bold]
    """
    from groundstation.dynamics.model import model_vehicle
    from groundstation.learn.planning import plan_flight
    from groundstation.learn.story import told_plan

    limits = _limits(height, space)
    require_new(output)
    loaded = fitted_model(model)
    firmware = model_vehicle(loaded).firmware
    if firmware != "2.x":
        raise BadInputError(
            f"--model {model}: a {loaded.vehicle} flies firmware {firmware}, which holds neither"
            " height nor place, so no program can fly its manoeuvres"
        )
    place = FastPlace(loaded.vehicle, limits.height_m, limits.reach_m, model)
    planned = plan_flight(place, loaded, limits, seconds)
    if output is not None:
        planned.write(output)
    answer(as_json, planned.as_dict(), told_plan(planned), output)


def _limits(height: float, space: str) -> Limits:
    from groundstation.learn.planning import Limits, require_limits

    try:
        width, depth = (float(side) for side in space.lower().split("x"))
    except ValueError:
        raise BadInputError(f"--space {space}: give two sides in m, 2x2 say") from None
    limits = Limits(reach_m=min(width, depth) / 2.0, height_m=height)
    require_limits(limits)
    return limits


def _begun(journal: Journal | None, asked: Task, output: Path) -> Journal:
    """The journal to go on with, on as many batteries as were ever asked for. Raises BadInputError
    where it was begun otherwise."""
    from groundstation.learn.planning import Journal

    if journal is None:
        return Journal(task=asked)
    begun = journal.task
    batteries = max(begun.batteries, asked.batteries)
    journal.task = msgspec.structs.replace(
        asked, vehicle=begun.vehicle, batteries=batteries, craft=begun.craft
    )
    if msgspec.structs.replace(begun, batteries=batteries) != journal.task:
        raise BadInputError(
            f"{output}: was begun with other options ({begun}); go on with those, or learn in"
            " another folder with -o"
        )
    if asked.link == "daemon" and begun.craft is None and journal.flights:
        raise BadInputError(
            f"{output}: an earlier version flew these flights and did not note which craft it was;"
            " learn in another folder with -o"
        )
    return journal


def _daemon_place(journal: Journal, told: Told) -> DaemonPlace:
    """For the daemon's craft, as often as nobody presses Stop."""
    task = journal.task
    return DaemonPlace(task.height_m, task.reach_m, stops_begun(socket_path()), told, task.craft)


def _craft_text(link: str) -> str:
    """Settings of the software craft, for the folder. Raises BadInputError."""
    from groundstation import load_model, load_vehicle

    source = link.partition(":")[2]
    if source.endswith(".json"):
        load_model(source)
        path = json.dumps(str(Path(source).absolute()))
        return f'[stand_in]\nplant = "model"\ncraft = {path}\nestimated = true\n'
    if not source.endswith(".toml"):
        load_vehicle(source)
        return f'[stand_in]\nplant = "reduced"\ncraft = "{source}"\n'
    try:
        return Path(source).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"--link {link}: cannot be read: {error}") from error


def _sealed(shell: Shell, hide: int | None) -> str:
    """The settings that fly: with effects hidden in them where a seed was given."""
    if hide is None:
        return CRAFT
    command = shell.keep if (shell.folder / SEALED).exists() else shell.run
    effects = HIDDEN_EFFECTS[hide % len(HIDDEN_EFFECTS)]
    words = f"--settings {CRAFT} --seed {hide} --effects {effects} -o {SEALED}"
    command("python", "-m", "firmware_sim.hide", *words.split())
    return SEALED


def _preflight(
    pilot: Place, journal: Journal, limits: Limits, yes: bool, store: bool, told: Told
) -> None:
    """Say what will happen; ask where motors of a real craft would turn."""
    from groundstation.learn.story import flights_ahead

    says = pilot.says()
    if store:
        pilot.require_storing()
    journal.task = msgspec.structs.replace(journal.task, vehicle=says.vehicle or "crazyflie21")
    if isinstance(pilot, DaemonPlace):
        journal.task = msgspec.structs.replace(journal.task, craft=says.craft)
        pilot.craft = says.craft
    battery = "" if says.battery_v is None else f", battery at {says.battery_v:.2f} V"
    told(f"craft: {says.craft}{battery}")
    count, seconds = flights_ahead(journal, limits)
    told(
        f"ahead: {count} flights, about {seconds:.0f} s in the air at {limits.height_m:g} m, on at"
        f" most {journal.task.batteries} batteries. It stays within {limits.reach_m:g} m of its"
        f" take-off, and lands {BEYOND_M:g} m beyond that."
    )
    if not says.software:
        told("Each flight is announced. Ctrl-C lands the craft; Ctrl-C again stops its motors.")
        if not yes:
            require_yes("clear of people, ready to fly?", "not flown")


def _store(journal: Journal, folder: Path, pilot: Place, told: Told) -> None:
    """Have the craft keep the gains that it was left with, where they flew better."""
    from groundstation.control.firmware_loop import load_gains
    from groundstation.learn.story import GAINS

    if not journal.gains.startswith("written"):
        told("stored: nothing, for no gains flew better")
        return
    found = load_gains(folder / GAINS)
    gains = {name: value for name, value in found.items() if isinstance(value, float)}
    told("stored on the craft: " + ", ".join(pilot.store(gains)))


def _report(journal: Journal, folder: Path, as_json: bool, told: Told) -> None:
    from groundstation.learn.report import REPORT, outcome_of, report_page

    outcome = outcome_of(journal, folder)
    (folder / REPORT).unlink(missing_ok=True)
    report_page(outcome).write(folder / REPORT)
    if as_json:
        show_json({**outcome.as_dict(), "report": str(folder / REPORT)})
    else:
        for line in outcome.lines():
            told(line)
        told(f"{folder / REPORT}   ({journal.seconds:.0f} s)")
    if outcome.wrong:
        raise GroundStationError(
            f"not everything came true ({', '.join(outcome.wrong)}): see {folder / REPORT}"
        )


def _undo(journal: Journal | None, folder: Path) -> None:
    """By the daemon's note, of whoever flew, and by what was written from this folder; what the
    craft has stored of its gains is cleared."""
    from groundstation.learn.planning import BEING_WRITTEN

    if journal is None or journal.task.link != "daemon":
        raise BadInputError(f"{folder}: no gains were written from here; nothing to put back")
    may_be_there = journal.gains.startswith(("written", BEING_WRITTEN))
    former = journal.former if may_be_there else {}
    restored = ask(socket_path(), "POST", "/command/restore")["values"]
    cleared: list[str] = []
    if former:
        cleared = _daemon_place(journal, show).put_back(former)
        journal.gains = f"put back by --undo; they were {journal.gains}"
        journal.save(folder)
    if not (former or restored):
        raise BadInputError(f"{folder}: no gains were written from here; nothing to put back")
    show("the former gains are back: " + ", ".join(sorted({*former, *restored})))
    if cleared:
        show("stored gains cleared: " + ", ".join(cleared))


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


# Who flies: the software craft in fast time, or the daemon's craft.


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
        from groundstation.learn.planning import Flown

        craft = self._craft(seed)
        room = Room(self.height_m, 0.0, self.reach_m)
        with Interrupts() as signals:
            try:
                craft.arm()
                craft.write({**lets_sink(craft.parameters()), **(gains or {})})
                flying = gains_of(craft.parameters())
                ended = fly_by_height(
                    craft, programme, room, signals, tells_battery=True, clock=craft
                )
            finally:
                craft.stop()
                craft.save(file)
        if signals.last is not None:
            raise signals.last
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
        from groundstation.learn.planning import Craft

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
        from groundstation.learn.planning import Flown

        await_connection(socket_path())
        require_calm(self.stops)
        with self._commanded() as pilot:
            ready = require_ready(pilot, needs_battery=False, may_be_disarmed=True)
            tells = ready["battery_v"] is not None
            require_height(pilot)
            require_place(pilot)
            flight = Flight(pilot)
            flight.change({**lets_sink(flight.before), **(gains or {})})
            flying = flight.gains
            floor_m = await_take_off(pilot, file.name, self.told)
            self.told(f"flying {file.name}. Ctrl-C lands it.")
            room = Room(self.height_m, floor_m, self.reach_m)
            ended = flight.fly(
                lambda signals: fly_by_height(pilot, programme, room, signals, tells_battery=tells),
                f"{CLIENT} begins",
                purpose=file.name,
            )
        say(ended.motors, error=True)
        recording = Path(ended.recording)
        try:
            with recording.open("rb") as source, written_whole(file) as target:
                shutil.copyfileobj(source, target)
        except OSError as error:
            raise GroundStationError(
                f"{file}: cannot be written: {error.strerror}; the flight is in {recording}"
            ) from error
        if ended.interrupted is not None:
            raise ended.interrupted
        by_hand = ended.why in (BY_OPERATOR, LANDED_BY_OPERATOR)
        return Flown(f"{BY_HAND}: {ended.why}" if by_hand else ended.why, ended.seconds, flying)

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
        self.write(gains)
        with self._commanded() as pilot:
            return store_gains(pilot, "the craft is learnt")

    def put_back(self, former: Mapping[str, float]) -> list[str]:
        """Write former gains, and clear stored ones; the names of the latter."""
        with self._commanded() as pilot:
            write_parameters(pilot, former)
            return sorted(clear_gains(pilot))

    def await_battery(self) -> None:
        """Wait for the craft with a full battery that stands still. Raises GroundStationError where
        none comes within ``WAIT_S``, or where motors were stopped since this program began."""
        still = time.monotonic()
        deadline = still + WAIT_S
        while time.monotonic() - still < CLEAR_S:
            require_calm(self.stops)
            full = False
            # the lease anew each time, for the craft is switched off meanwhile
            with contextlib.suppress(GroundStationError), self._commanded() as pilot:
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

    def says(self) -> Says:
        """Raises GroundStationError where it cannot fly."""
        from groundstation.learn.planning import Craft

        await_connection(socket_path())
        with self._commanded() as pilot:
            require_height(pilot)
            require_place(pilot)
            ready = require_ready(pilot, needs_battery=False, may_be_disarmed=True)
            vehicle = pilot.ask("GET", "/status")["vehicle"]
            lease = pilot.lease
        return Says(Craft(**lease["craft"]), vehicle, ready["battery_v"], lease["software"])

    def _commanded(self) -> Any:
        return commanded(CLIENT, self.stops, self.craft)


Place = FastPlace | DaemonPlace


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
    from groundstation import load_model
    from groundstation.control.step_analysis import analyse_recording
    from groundstation.learn.planning import rehearsal
    from groundstation.recording.formats import open_for_analysis

    loaded = load_model(model)
    place = FastPlace(loaded.vehicle, height_m, reach_m, model)
    with rehearsal(place, programme, seed=SEED, gains=gains) as (flown, file):
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
    table = next(iter(recording.tables.values()))
    x, y, _, vx, vy, _ = (np.asarray(table.columns[name], np.float64) for name in PLACE)
    told = {
        "seconds": flown.seconds,
        "farthest_m": float(np.hypot(x, y).max()),
        "top_m_s": float(np.hypot(vx, vy).max()),
        "lean_deg": float(np.degrees(np.abs(recording.samples.attitude[:, :2]).max())),
    }
    return told, steps
