"""``learn`` and ``plan``: from a craft to a better craft, and what to fly next by hand."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from groundstation import BadInputError, GroundStationError
from groundstation.cli.flying import STORE
from groundstation.cli.model_files import AS_JSON, fitted_model, require_new, say_written
from groundstation.cli.terminal import own_terminal, require_yes, show, show_json, shown, tell_found

if TYPE_CHECKING:
    from groundstation.cli.learn_flights import DaemonPlace, Place
    from groundstation.learn.planning import Journal, Limits, Task
    from groundstation.shell import Shell

Told = Callable[[str], None]
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
    from groundstation.cli.learn_flights import SOFTWARE
    from groundstation.learn.planning import journal_in

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
    task = _task(link, limits, seed, batteries, hide)
    _lead(_begun(journal, task, output), output, limits, yes, store, as_json)


def _lead(
    journal: Journal, output: Path, limits: Limits, yes: bool, store: bool, as_json: bool
) -> None:
    """From wherever the journal is to the report; the folder keeps it, whatever ends this."""
    from groundstation.cli.learn_flights import SOFTWARE, FastPlace
    from groundstation.shell import Shell

    link = journal.task.link
    inputs: dict[str, str | None] = {"flight*.mcap": None, "proof.mcap": None}
    if link.startswith(SOFTWARE):
        inputs = {CRAFT: _craft_text(link), **inputs}
        FastPlace(link.partition(":")[2], limits.height_m, limits.reach_m).says()
    begun_s = time.monotonic()

    def told(text: str) -> None:
        show(text, error=as_json)
        progress(_share(journal, limits), text)

    with (
        shown("looking at the craft") as progress,
        Shell(output, inputs, lambda line: told(f"  {line}"), "groundstation learn", True) as shell,
    ):
        if link.startswith(SOFTWARE):
            sealed = _sealed(shell, journal.task.hide)
            source = str(shell.folder / sealed)
            pilot: Place = FastPlace(source, limits.height_m, limits.reach_m)
        else:
            pilot = _daemon_place(journal, told)
        journal.save(shell.folder)
        _preflight(pilot, journal, limits, yes, store, told)
        try:
            _learn(journal, shell, pilot, told)
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
    from groundstation.cli.learn_flights import FastPlace
    from groundstation.dynamics.model import model_vehicle
    from groundstation.learn.planning import plan_flight
    from groundstation.learn.story import told_plan

    limits = _limits(height, space)
    if output is not None:
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
    if as_json:
        show_json(planned.as_dict())
        return
    for line in told_plan(planned):
        show(line)
    say_written(output)


def _limits(height: float, space: str) -> Limits:
    from groundstation.learn.planning import Limits, require_limits

    try:
        width, depth = (float(side) for side in space.lower().split("x"))
    except ValueError:
        raise BadInputError(f"--space {space}: give two sides in m, 2x2 say") from None
    limits = Limits(reach_m=min(width, depth) / 2.0, height_m=height)
    require_limits(limits)
    return limits


def _task(link: str, limits: Limits, seed: int, batteries: int, hide: int | None) -> Task:
    from groundstation.learn.planning import Task

    return Task(
        link=link,
        vehicle="",
        height_m=limits.height_m,
        reach_m=limits.reach_m,
        seed=seed,
        batteries=batteries,
        hide=hide,
    )


def _begun(journal: Journal | None, asked: Task, output: Path) -> Journal:
    """The journal to go on with, on as many batteries as were ever asked for. Raises BadInputError
    where it was begun otherwise."""
    import msgspec

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
    from groundstation import socket_path
    from groundstation.cli.flying import await_connection, stops_begun
    from groundstation.cli.learn_flights import DaemonPlace

    path = socket_path()
    await_connection(path)
    task = journal.task
    return DaemonPlace(task.height_m, task.reach_m, stops_begun(path), told, task.craft)


def _craft_text(link: str) -> str:
    """Settings of the software craft, for the folder. Raises BadInputError."""
    from groundstation import load_vehicle

    source = link.partition(":")[2]
    if source.endswith(".json"):
        from groundstation import load_model

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
    command(
        "python",
        "-m",
        "firmware_sim.hide",
        "--settings",
        CRAFT,
        "--seed",
        str(hide),
        "--effects",
        str(HIDDEN_EFFECTS[hide % len(HIDDEN_EFFECTS)]),
        "-o",
        SEALED,
    )
    return SEALED


def _preflight(
    pilot: Place, journal: Journal, limits: Limits, yes: bool, store: bool, told: Told
) -> None:
    """Say what will happen; ask where motors of a real craft would turn."""
    import msgspec

    from groundstation.cli.learn_flights import DaemonPlace
    from groundstation.control.programme import BEYOND_M
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


def _learn(journal: Journal, shell: Shell, pilot: Place, told: Told) -> None:
    from groundstation.cli.learn_flights import FastPlace
    from groundstation.learn.story import Learner

    plain, task = shell.folder / CRAFT, journal.task
    source = str(plain) if plain.exists() else task.vehicle

    def rehearse(model: Path) -> FastPlace:
        return FastPlace(source, task.height_m, task.reach_m, str(model))

    Learner(journal, shell, pilot, rehearse, told).learn()


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


def _share(journal: Journal, limits: Limits) -> float:
    """Of the flights that there are at most, what has been flown."""
    from groundstation.learn.story import flights_ahead

    flown = sum(not one.aborted for one in journal.flights)
    return flown / (flown + flights_ahead(journal, limits)[0])


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
    from groundstation import socket_path
    from groundstation.service.client import ask

    if journal is None or journal.task.link != "daemon":
        raise BadInputError(f"{folder}: no gains were written from here; nothing to put back")
    former = journal.former if journal.gains.startswith("written") else {}
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
