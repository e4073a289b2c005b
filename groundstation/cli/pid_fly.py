"""``pid fly``: gains and a programme on a craft, by the daemon's control API."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation import BadInputError, GroundStationError, Pilot, socket_path
from groundstation.cli.commanding import (
    await_connection,
    begin_recording,
    end_recording,
    patient,
    require_consent,
    require_ended,
    require_height,
    require_ready,
)
from groundstation.cli.craft_parameters import (
    left_on,
    put_back,
    put_back_left,
    why_aborted,
    write_parameters,
)
from groundstation.cli.left_changed import (
    Written,
    also_written,
    changes_left,
    crafts_left,
    note_changes,
)
from groundstation.cli.model_files import (
    AS_JSON,
    require_new,
    say_written,
)
from groundstation.cli.pid_manoeuvres import (
    HOLD_HEIGHT,
    NOMINAL_V,
    fly_programme,
    stop_motors,
)
from groundstation.cli.pid_whose import Whose
from groundstation.cli.sticks import Source, StandInPilot, open_sticks
from groundstation.cli.terminal import say, show, show_json

if TYPE_CHECKING:
    from groundstation import Recording
    from groundstation.control.programme import Programme
    from groundstation.control.step_analysis import Flown

CLIENT = "pid fly"
THRUST = typer.Option(
    "",
    help="stand-in, height:0.5 (m, held by a craft that knows its height), keyboard or"
    " gamepad:/dev/input/js0 (default: by what the craft can).",
)


def fly(
    gains: Path | None = typer.Option(
        None, "--gains", help="TOML file of firmware gains; none: measure what is there."
    ),
    model: str | None = typer.Option(None, "--model", help="Model file, for the prediction."),
    programme: str = typer.Option(
        "doublet", "--programme", help="doublet, step, or level (hover, manual flight)."
    ),
    axis: list[str] | None = typer.Option(
        None, "--axis", help="roll, pitch or yaw; repeatable (default: all)."
    ),
    amplitude: float = typer.Option(10.0, help="Roll and pitch, deg."),
    yaw_rate: float = typer.Option(60.0, help="Yaw, deg/s."),
    hold: float = typer.Option(1.0, help="How long each level is held, s."),
    rest: float = typer.Option(1.0, help="Level flight between manoeuvres, s."),
    repeat: int = typer.Option(8, help="Manoeuvres an axis; more of them, less noise."),
    firmware: str | None = typer.Option(
        None,
        "--firmware",
        help="2014 or 2.x, where neither file nor craft say whose the gains are.",
    ),
    thrust: str = THRUST,
    restore: bool = typer.Option(False, "--restore", help="Put the former gains back after it."),
    undo: bool = typer.Option(
        False, "--undo", help="Only put back what an interrupted flight left changed."
    ),
    dry_run: bool = typer.Option(False, "--dry-run", help="Show what would be flown."),
    yes: bool = typer.Option(False, "--yes", help="Do not ask before a real craft flies."),
    html: Path | None = typer.Option(None, "--html", help="Write a report to this new file."),
    as_json: bool = AS_JSON,
) -> None:
    """Fly gains through steps or doublets, and compare with the prediction.

    A client of a running daemon with a command link ('groundstation run --command ...'). Ctrl-C
    stops the motors.

    Example: [bold]groundstation pid fly --gains gains.toml --model body.json --restore[/bold]
    """
    from groundstation.control.pid import AXES
    from groundstation.control.programme import Programme, require_flyable

    if html is not None:
        require_new(html)
    planned = Programme(
        programme,  # type: ignore[arg-type]  # require_flyable judges it
        *(tuple(axis or AXES), amplitude, yaw_rate, hold, rest, repeat),
    )
    require_flyable(planned)
    whose = Whose(gains, model, firmware)
    wanted = whose.wanted()
    if dry_run:
        _show(planned, wanted, as_json)
        return
    if undo:
        _undo()
        return
    report = _flight(planned, wanted, whose, restore, thrust, yes)
    require_ended(report, "flight")
    _judge(report, planned, model, html, as_json)


def _show(programme: Programme, wanted: dict[str, float], as_json: bool) -> None:
    plan = {**programme.as_dict(), "seconds": programme.seconds, "reach_m": programme.reach_m}
    if as_json:
        show_json({"programme": plan, "gains": wanted})
        return
    show(
        f"{programme.repeats} {programme.shape}s an axis ({', '.join(programme.axes)}):"
        f" {programme.angle_deg:g} deg, yaw {programme.yaw_dps:g} deg/s,"
        f" held {programme.hold_s:g} s"
    )
    show(
        f"{programme.seconds:.0f} s with {programme.reach_m:.1f} m to either side at most,"
        " if nothing slows the craft down"
    )
    for name, value in wanted.items():
        show(f"  {name} = {value:g}")


def _flight(
    programme: Programme,
    wanted: dict[str, float],
    whose: Whose,
    restore: bool,
    thrust: str,
    yes: bool,
) -> dict[str, Any]:
    """Everything that touches the craft; what happened."""
    path = socket_path()
    await_connection(path)
    with Pilot(path, CLIENT) as pilot:
        uri = pilot.lease["uri"]
        release = whose.require(pilot.lease["firmware"], uri)
        real = not uri.startswith("udp://")
        if real and thrust == "stand-in":
            raise BadInputError(f"--thrust stand-in: {uri} is a real craft; a human gives thrust")
        before = pilot.parameters()
        former, written = left_on(uri, before)
        unknown = [name for name in wanted if name not in before]
        if unknown:
            raise BadInputError(
                f"the craft has no parameter {', '.join(unknown)}; nothing was written"
            )
        tells_battery = require_ready(pilot, needs_battery=False)["battery_v"] is not None
        if real and not yes:
            require_consent(pilot, f"{uri}: clear of people, ready to fly?", "not flown")
        by_itself = pilot.lease["holds_height"]
        # where it stands now: it may have been put elsewhere before it was said to be ready
        floor_m = pilot.setpoint(0.0, 0.0, 0.0, 0)["height_m"] or 0.0
        if thrust.startswith("height"):
            require_height(pilot, f"--thrust {thrust}: ")
        usual = "height" if by_itself else "keyboard" if real else "stand-in"
        with open_sticks(thrust or usual, floor_m) as sticks:
            recording = begin_recording(path)
            holds = HOLD_HEIGHT in before and isinstance(sticks, StandInPilot)
            changed = {**wanted, HOLD_HEIGHT: 1.0} if holds else dict(wanted)
            # what an interrupted flight found is what the craft had
            saved = {name: former.get(name, before[name]) for name in changed}
            changes = _Changes(changed, saved, former, written, {} if restore else wanted)
            details = {
                "programme": programme.as_dict(),
                "gains": wanted,
                "saved": saved,
                "firmware": release,
                "flown": _flown_gains(before, wanted),
            }
            flown = _flown(pilot, programme, sticks, changes, details, tells_battery)
    return {
        **flown,
        "recording": end_recording(path, recording, flown["aborted"]),
        "gains": details["flown"],
        "firmware": release,
    }


@dataclass(frozen=True, slots=True)
class _Changes:
    """Parameters that a flight writes. changed: all of them, saved: what the craft had. former,
    written: as an interrupted flight left them. stays: what is not put back after a good flight."""

    changed: dict[str, float]
    saved: dict[str, float]
    former: dict[str, float]
    written: Written
    stays: dict[str, float]

    def put_back(self, pilot: Pilot, aborted: str) -> list[str]:
        """The names of what is put back."""
        stays = {} if aborted else self.stays
        back = {name: value for name, value in self.saved.items() if name not in stays}
        earlier = {name: v for name, v in self.former.items() if name not in self.changed}
        put_back(pilot, CLIENT, back, earlier, self.written, aborted)
        return sorted(back)


def _flown(
    pilot: Pilot,
    programme: Programme,
    sticks: Source,
    changes: _Changes,
    details: dict[str, Any],
    tells_battery: bool,
) -> dict[str, Any]:
    """Fly with the changes, stop the motors and put back what does not stay."""
    if changes.changed:
        saved = {**changes.former, **changes.saved}
        note_changes(pilot.lease["uri"], saved, also_written(changes.written, changes.changed))
    aborted, motors, stopped = "an unforeseen error", "", False
    try:
        write_parameters(pilot, changes.changed)
        pilot.mark("pid fly begins", **details)
        say(f"{pilot.lease['uri']}: {sticks.help}; Ctrl-C stops", error=True)
        aborted = fly_programme(pilot, programme, sticks, tells_battery=tells_battery)
    except KeyboardInterrupt as stop:
        aborted, stopped = str(stop) or "Ctrl-C", True
    except GroundStationError as error:
        aborted = why_aborted(error)
    finally:
        # motors first: parameters may take a while
        with patient():
            if stopped:  # said where another Ctrl-C can no longer prevent it
                say("stopping the motors", error=True)
            motors = stop_motors(pilot)
        back = changes.put_back(pilot, aborted)
    return {"aborted": aborted, "motors": motors, "restored": back}


def _flown_gains(before: dict[str, float], wanted: dict[str, float]) -> dict[str, float]:
    return {name: value for name, value in before.items() if name.startswith("pid_")} | wanted


def _undo() -> None:
    crafts = crafts_left()
    if not crafts:
        show("nothing was left changed")
        return
    path = socket_path()
    await_connection(path)
    with Pilot(path, CLIENT) as pilot:
        uri = pilot.lease["uri"]
        if changes_left(uri) is None:
            raise BadInputError(
                f"the changes were made on {', '.join(crafts)}, the daemon commands {uri};"
                " nothing was written"
            )
        former = put_back_left(pilot, pilot.parameters())
    if former:
        show("the former values are back: " + ", ".join(former))
    else:
        show("nothing is left changed: the craft has been restarted or set anew since that flight")


def _require_supply(recording: Recording) -> None:
    """A prediction needs a voltage: the nominal one of a craft that told none."""
    import numpy as np

    voltage = recording.samples.battery_v
    if not np.isfinite(voltage).any():
        voltage[:] = NOMINAL_V
        say(f"no battery was told: the prediction is for {NOMINAL_V:g} V", error=True)


def _judge(
    report: dict[str, Any],
    programme: Programme,
    model: str | None,
    html: Path | None,
    as_json: bool,
) -> None:
    """Metrics of the recording, beside the model's."""
    flown: Flown | None = None
    if programme.shape != "level":
        from groundstation import load_model, open_recording
        from groundstation.control.step_recording import analyse_recording

        if not Path(report["recording"]).exists():
            raise BadInputError(
                f"the flight was recorded to {report['recording']}, which is not there: start"
                " pid fly where it can read the daemon's recordings"
            )
        loaded = None if model is None else load_model(model)
        recording = open_recording(Path(report["recording"]))
        if loaded is not None:
            _require_supply(recording)
        try:
            flown = analyse_recording(
                recording, loaded, report["gains"], CLIENT, report["firmware"]
            )
        except BadInputError as error:
            raise BadInputError(
                f"flown and recorded to {report['recording']}, but not measured: {error}"
            ) from error
        report["delay_s"], report["delay_spread_s"] = flown.delay_s, flown.spread_s
        report["axes"] = {one.axis: one.as_dict() for one in flown.axes}
        if html is not None:
            from groundstation.control.report import flight_page

            flight_page(flown, Path(report["recording"]).name, model).write(html)
    if as_json:
        show_json(report)
        return
    show(f"recording: {report['recording']}")
    if flown is None:
        return
    from groundstation.control.report import flight_lines

    for line in flight_lines(flown):
        show(line)
    say_written(html)
