"""``bench``: a craft that is fixed, its motors driven and identified (thesis 7.2)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation import BadInputError, GroundStationError, Pilot, socket_path
from groundstation.cli.command_group import Commands
from groundstation.cli.commanding import (
    await_connection,
    begin_recording,
    end_recording,
    patient,
    require_consent,
    require_ended,
    require_ready,
)
from groundstation.cli.fit import fit_motor
from groundstation.cli.model_files import AS_JSON, HTML, MASS, VEHICLE, require_new
from groundstation.cli.pid_manoeuvres import SetpointClock, stop_motors
from groundstation.cli.terminal import say, show, show_json

if TYPE_CHECKING:
    from groundstation.control.thrust_profile import ThrustProfile

CLIENT = "bench motor"
WARNING = (
    "PROPELLERS WILL TURN at up to {high:.0%} of full thrust for {seconds:.0f} s: craft fixed to"
    " the bench, nothing near the propellers, eyes protected, nobody in their plane"
)


def add_commands(app: typer.Typer) -> None:
    bench = Commands(
        no_args_is_help=True,
        help="A craft fixed to a bench: drive its motors and identify them."
        "\n\nExample: [bold]groundstation bench motor --profile steps -o motor.json[/bold]",
    )
    bench.command("motor")(motor)
    app.add_typer(bench, name="bench")


def motor(
    profile: str = typer.Option(
        "steps", "--profile", help="steps (random levels), staircase or chirp (0.1 to 5 Hz)."
    ),
    low: float = typer.Option(0.3, help="Least thrust, share of full."),
    high: float = typer.Option(0.8, help="Most thrust, share of full."),
    hold: float = typer.Option(0.4, help="How long each level is held, s."),
    seconds: float = typer.Option(40.0, help="How long the motors are driven."),
    seed: int = typer.Option(0, help="Of the random levels."),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="Fit the motor to this new model file."
    ),
    number: int = typer.Option(1, "--motor", min=1, max=4, help="Which carries the speed sensor."),
    effects: str = typer.Option("", "--with", help="Effects to fit, as 'fit motor --with'."),
    vehicle: str | None = VEHICLE,
    mass: float | None = MASS,
    dry_run: bool = typer.Option(False, "--dry-run", help="Show what would be driven."),
    yes: bool = typer.Option(
        False, "--yes", help="Do not ask before the propellers of a real craft turn."
    ),
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """Drive the motors of a fixed craft through a thrust profile, record, and fit a motor.

    A client of a running daemon with a command link ('groundstation run --command ...'). Needs a
    speed sensor on one propeller, or a craft that logs its rotors' speeds. Ctrl-C stops the
    motors.

    Example: [bold]groundstation bench motor --profile steps -o motor.json[/bold]
    """
    from groundstation.control.thrust_profile import ThrustProfile, require_drivable

    planned = ThrustProfile(
        shape=profile,  # type: ignore[arg-type]  # require_drivable judges it
        low=low,
        high=high,
        hold_s=hold,
        seconds=seconds,
        seed=seed,
    )
    require_drivable(planned)
    for path in (output, html):
        if path is not None:
            require_new(path)
    if html is not None and output is None:
        raise BadInputError("--html: a report of a fit, which needs -o")
    if dry_run:
        if as_json:
            show_json({"profile": planned.as_dict()})
            return
        show(f"{profile} between {low:.0%} and {high:.0%} of full thrust, {seconds:g} s")
        show(WARNING.format(high=high, seconds=seconds))
        return
    report = _drive(planned, yes)
    require_ended(report, "bench")
    if output is None:
        if as_json:
            show_json(report)
        else:
            show(f"recording: {report['recording']}; 'groundstation fit motor' fits it")
        return
    fit_motor(
        recordings=[_recorded(report)],
        output=output,
        validate=None,
        vehicle=vehicle,
        mass=mass,
        model=None,
        effects=effects,
        motor=number,
        segment=None,
        html=html,
        as_json=as_json,
    )


def _recorded(report: dict[str, Any]) -> Path:
    """The recording of what was driven. Raises BadInputError where it cannot be read from here."""
    recording = Path(report["recording"])
    if not recording.exists():
        raise BadInputError(
            f"driven and recorded to {recording}, which is not there: start bench motor where it"
            " can read the daemon's recordings"
        )
    say(f"recording: {recording}", error=True)
    return recording


def _drive(profile: ThrustProfile, yes: bool) -> dict[str, Any]:
    """Everything that touches the craft; what happened."""
    path = socket_path()
    await_connection(path)
    with Pilot(path, CLIENT) as pilot:
        uri = pilot.lease["uri"]
        at_rest = require_ready(pilot, needs_battery=True)
        say(WARNING.format(high=profile.high, seconds=profile.seconds), error=True)
        if not yes and not uri.startswith("udp://"):
            require_consent(pilot, f"{uri}: fixed, and clear of people?", "not driven")
        recording = begin_recording(path)
        aborted, motors = "an unforeseen error", ""
        try:
            pilot.mark("bench motor begins", profile=profile.as_dict())
            say(f"{uri}: Ctrl-C stops", error=True)
            aborted = _follow(pilot, profile, at_rest)
        except KeyboardInterrupt as stop:
            aborted = str(stop) or "Ctrl-C"
        except GroundStationError as error:
            aborted = str(error)
        finally:
            with patient():
                motors = stop_motors(pilot)
    return {
        "aborted": aborted,
        "motors": motors,
        "recording": end_recording(path, recording, aborted),
        "profile": profile.as_dict(),
    }


def _follow(pilot: Pilot, profile: ThrustProfile, at_rest: dict[str, Any]) -> str:
    """The profile, setpoint by setpoint; why it was cut short, or empty."""
    from groundstation.control.programme import LowBattery
    from groundstation.control.thrust_profile import reason_to_stop

    clock, low = SetpointClock(), LowBattery()
    for thrust in profile.thrusts().tolist():
        reason = reason_to_stop(pilot.setpoint(0.0, 0.0, 0.0, thrust), at_rest, low)
        if reason:
            return reason
        clock.wait()
    return ""
