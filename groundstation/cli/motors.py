"""``motors``: what an operator may do to the motors, whoever commands."""

from __future__ import annotations

import typer

from groundstation import GroundStationError, socket_path
from groundstation.cli.command_group import Commands
from groundstation.cli.model_files import AS_JSON
from groundstation.cli.terminal import require_yes, show, show_json
from groundstation.links.command import is_software
from groundstation.service.client import ask
from groundstation.service.lease import LANDED, STOPPED

motors = Commands(
    help=(
        "Land the craft that the running daemon commands, stop, arm or disarm its motors, or let it"
        " recover from a crash."
        "\n\nExample: [bold]groundstation motors stop[/bold]"
    ),
    no_args_is_help=True,
)


def add_commands(app: typer.Typer) -> None:
    app.add_typer(motors, name="motors")


@motors.command("stop")
def stop(as_json: bool = AS_JSON) -> None:
    """Stop the motors immediately, whoever is flying. A craft in the air falls.

    Every program that was started before loses control, and learn ends. Fails if the telemetry
    does not confirm within 3 s that the motors stand.

    Example: [bold]groundstation motors stop[/bold]
    """
    _end("stop", (STOPPED,), as_json)


@motors.command("land")
def land(as_json: bool = AS_JSON) -> None:
    """Land the craft, whoever is flying, and stop its motors on the ground.

    Every program that was started before loses control, and learn ends. Takes up to 6 s. Needs a
    craft that holds its height. One that does not fly is said to be stopped. Fails if the telemetry
    does not confirm it.

    Example: [bold]groundstation motors land[/bold]
    """
    _end("land", (LANDED, STOPPED), as_json)


@motors.command("arm")
def arm(
    yes: bool = typer.Option(False, "--yes", help="Do not ask before a real craft is armed."),
    as_json: bool = AS_JSON,
) -> None:
    """Arm the motors of a craft that needs it, and wait for its answer.

    The motors of a Brushless idle as soon as they are armed. Firmware of 2014 knows no arming, and
    a Crazyflie 2.1 arms itself.

    Example: [bold]groundstation motors arm[/bold]
    """
    command = ask(socket_path(), "GET", "/status")["command"]
    if command is not None and not is_software(command["uri"]) and not yes:
        question = f"{command['uri']}: clear of people, propellers may turn; arm its motors?"
        require_yes(question, "not armed")
    ask(socket_path(), "POST", "/command/arm", {"on": True})
    _report("armed", as_json)


@motors.command("disarm")
def disarm(as_json: bool = AS_JSON) -> None:
    """Disarm the motors, whoever commands, and wait for the craft's answer.

    Example: [bold]groundstation motors disarm[/bold]
    """
    ask(socket_path(), "POST", "/command/arm", {"on": False})
    _report("disarmed", as_json)


@motors.command("recover")
def recover(as_json: bool = AS_JSON) -> None:
    """Let a craft that calls itself crashed be ready again, once it stands upright.

    Example: [bold]groundstation motors recover[/bold]
    """
    ask(socket_path(), "POST", "/command/recover")
    _report("recovered", as_json)


def _end(how: str, done: tuple[str, ...], as_json: bool) -> None:
    """Ask for the end of whatever flies. Raises GroundStationError unless it is one of ``done``."""
    answer = ask(socket_path(), "POST", f"/command/{how}")
    motors, ended = answer["motors"], answer["ended"]
    more = "".join(f"; {kind} was ended" for kind in ended) + "; nobody is in control now"
    if motors not in done:
        raise GroundStationError(motors + more)
    if as_json:
        show_json({"motors": motors, "ended": ended})
    else:
        show(motors + more)


def _report(state: str, as_json: bool) -> None:
    if as_json:
        show_json({"motors": state})
    else:
        show(state)
