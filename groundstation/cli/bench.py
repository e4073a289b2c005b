"""``bench``: a craft that is fixed, its motors driven and recorded (thesis 7.2)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from groundstation import Pilot, socket_path
from groundstation.cli.flying import (
    Flight,
    SetpointClock,
    commanded,
    require_consent,
    require_ready,
    stopped_after,
    stops_begun,
)
from groundstation.cli.model_files import AS_JSON, answer
from groundstation.cli.terminal import Commands, say

if TYPE_CHECKING:
    from groundstation.control.programme import ThrustProfile

CLIENT = "bench motor"
WARNING = (
    "PROPELLERS WILL TURN at up to {high:.0%} of full thrust for {seconds:.0f} s: craft fixed to"
    " the bench, nothing near the propellers, eyes protected, nobody in their plane"
)


def add_commands(app: typer.Typer) -> None:
    bench = Commands(
        no_args_is_help=True,
        help="A craft fixed to a bench: drive its motors, for them to be identified."
        "\n\nExample: [bold]groundstation bench motor --profile steps[/bold]",
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
    dry_run: bool = typer.Option(False, "--dry-run", help="Show what would be driven."),
    yes: bool = typer.Option(
        False, "--yes", help="Do not ask before the propellers of a real craft turn."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Drive the motors of a fixed craft through a thrust profile and record it, for 'fit motor'.

    A client of a running daemon with a command link ('groundstation run --command ...'). Needs a
    speed sensor on one propeller, or a craft that logs its rotors' speeds. Ctrl-C stops the
    motors.

    Example: [bold]groundstation bench motor --profile steps[/bold]
    """
    from groundstation.control.programme import ThrustProfile, require_drivable

    planned = ThrustProfile(
        shape=profile,  # type: ignore[arg-type]  # require_drivable judges it
        low=low,
        high=high,
        hold_s=hold,
        seconds=seconds,
        seed=seed,
    )
    require_drivable(planned)
    if dry_run:
        what = f"{profile} between {low:.0%} and {high:.0%} of full thrust, {seconds:g} s"
        warning = WARNING.format(high=high, seconds=seconds)
        answer(as_json, {"profile": planned.as_dict()}, [what, warning])
        return
    report = _drive(planned, yes)
    line = f"recording: {report['recording']}; 'groundstation fit motor' fits it"
    answer(as_json, report, [line])


def _drive(profile: ThrustProfile, yes: bool) -> dict[str, Any]:
    """Everything that touches the craft; what happened."""
    with commanded(CLIENT, stops_begun(socket_path())) as pilot:
        uri = pilot.lease["uri"]
        at_rest = require_ready(pilot, needs_battery=True)
        say(WARNING.format(high=profile.high, seconds=profile.seconds), error=True)
        if not (yes or pilot.lease["software"]):
            require_consent(pilot, f"{uri}: fixed, and clear of people?", "not driven")
        say(f"{uri}: Ctrl-C stops", error=True)
        ended = Flight(pilot).fly(
            lambda signals: stopped_after(lambda: _follow(pilot, profile, at_rest), pilot, signals),
            f"{CLIENT} begins",
            profile=profile.as_dict(),
        )
    ended.require("bench")
    return {
        "aborted": ended.why,
        "motors": ended.motors,
        "recording": ended.recording,
        "profile": profile.as_dict(),
    }


def _follow(pilot: Pilot, profile: ThrustProfile, at_rest: dict[str, Any]) -> str:
    """The profile, setpoint by setpoint; why it was cut short, or empty."""
    from groundstation.control.programme import LowBattery, reason_to_stop

    clock, low = SetpointClock(), LowBattery()
    for thrust in profile.thrusts().tolist():
        reason = reason_to_stop(pilot.setpoint(0.0, 0.0, 0.0, thrust), at_rest, low)
        if reason:
            return reason
        clock.wait()
    return ""
