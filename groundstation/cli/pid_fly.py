"""``pid fly``: gains and a programme on a craft, by the daemon's control API."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation.cli.left_changed import changes_left, forget_changes, note_changes
from groundstation.cli.model_files import AS_JSON, require_new
from groundstation.cli.sticks import Source, StandInPilot, open_sticks
from groundstation.cli.terminal import say
from groundstation.errors import BadInputError, GroundStationError
from groundstation.service.client import Pilot, ask
from groundstation.service.config import socket_path

if TYPE_CHECKING:
    from groundstation.control.flown import Flown
    from groundstation.control.programme import Programme

CLIENT = "pid fly"
HOLD_HEIGHT = "flightmode.althold"
MOTORS_ON = 10000
"""The firmware takes less thrust for none."""
DESCENT = 0.97
"""Thrust of the landing, as a share of what hovered: about 0.5 m/s^2 downwards."""
DESCENT_S = 2.4
TOUCHED_DPS = 150.0
"""Level flight never turns so fast: the ground has been met."""
LEAST_REST_V = 3.5
"""Battery at rest below which a flight does not begin."""
TAKE_OFF_S = 3.0
STOPPED_S = 3.0
CONNECT_S, TELEMETRY_S = 20.0, 5.0
"""How long a daemon that has just started is waited for."""


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
    thrust: str = typer.Option(
        "", help="stand-in, keyboard or gamepad:/dev/input/js0 (default: by the command link)."
    ),
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
    from groundstation.control.cascade import require_gains
    from groundstation.control.gains_file import load_gains
    from groundstation.control.pid import AXES, PidGains
    from groundstation.control.programme import Programme, require_flyable
    from groundstation.dynamics.model import load_model

    if html is not None:
        require_new(html)
    planned = Programme(
        shape=programme,  # type: ignore[arg-type]
        axes=tuple(axis or AXES),
        angle_deg=amplitude,
        yaw_dps=yaw_rate,
        hold_s=hold,
        rest_s=rest,
        repeats=repeat,
    )
    require_flyable(planned)
    wanted: dict[str, float] = {}
    if gains is not None:
        for name, value in load_gains(gains).items():
            if isinstance(value, PidGains):
                raise BadInputError(
                    f"gains {gains}: the thesis's form cannot be flown, only the firmware's"
                )
            wanted[name] = value
        require_gains(wanted, f"gains {gains}")
    if model is not None:
        load_model(model)  # what is wrong with it is better known before the flight
    if dry_run:
        _show(planned, wanted, as_json)
        return
    if undo:
        _undo()
        return
    report = _flight(planned, wanted, restore, thrust, yes)
    if report["aborted"]:
        raise GroundStationError(
            f"flight aborted: {report['aborted']}; motors are off, the recording is"
            f" {report['recording']}"
        )
    _judge(report, planned, model, html, as_json)


def _show(programme: Programme, wanted: dict[str, float], as_json: bool) -> None:
    plan = {**programme.as_dict(), "seconds": programme.seconds, "reach_m": programme.reach_m}
    if as_json:
        typer.echo(json.dumps({"programme": plan, "gains": wanted}, indent=2))
        return
    typer.echo(
        f"{programme.repeats} {programme.shape}s an axis ({', '.join(programme.axes)}):"
        f" {programme.angle_deg:g} deg, yaw {programme.yaw_dps:g} deg/s,"
        f" held {programme.hold_s:g} s"
    )
    typer.echo(
        f"{programme.seconds:.0f} s with {programme.reach_m:.1f} m to either side at most,"
        " if nothing slows the craft down"
    )
    for name, value in wanted.items():
        typer.echo(f"  {name} = {value:g}")


def _flight(
    programme: Programme, wanted: dict[str, float], restore: bool, thrust: str, yes: bool
) -> dict[str, Any]:
    """Everything that touches the craft; what happened."""
    path = socket_path()
    _await_connection(path)
    left = changes_left()
    with Pilot(path, CLIENT) as pilot:
        uri = pilot.lease["uri"]
        real = not uri.startswith("udp://")
        if real and thrust == "stand-in":
            raise BadInputError(f"--thrust stand-in: {uri} is a real craft; a human gives thrust")
        with open_sticks(thrust or ("keyboard" if real else "stand-in")) as sticks:
            before = pilot.parameters()
            if left is not None:
                _tell_left(left, before)
            _require_ready(pilot, wanted, before)
            if real and not yes and not typer.confirm(f"{uri}: clear of people, ready to fly?"):
                raise BadInputError("not flown")
            recording = _begin_recording(path)
            changed = dict(wanted)
            if HOLD_HEIGHT in before and isinstance(sticks, StandInPilot):
                changed[HOLD_HEIGHT] = 1.0
            saved = {name: before[name] for name in changed}
            if changed:
                note_changes(uri, saved, changed)
            aborted = ""
            try:
                _write(pilot, changed)
                details = {"programme": programme.as_dict(), "gains": wanted, "saved": saved}
                pilot.mark("pid fly begins", **details)
                say(f"{uri}: {sticks.help}; Ctrl-C stops", error=True)
                aborted = _command(pilot, programme, sticks)
            except KeyboardInterrupt:
                aborted = "Ctrl-C"
            finally:
                # motors first: parameters may take a while
                _stop(pilot)
                kept = {} if restore or aborted else wanted
                back = {name: value for name, value in saved.items() if name not in kept}
                _settle(pilot, back, aborted)
    status = ask(path, "POST", "/record/stop")
    if recording["was_on"]:
        ask(path, "POST", "/record/start")
    return {
        "aborted": aborted,
        "recording": status.get("path") or status["file"],
        "gains": {name: before[name] for name in before if name.startswith("pid_")} | wanted,
        "restored": sorted(back),
    }


def _await_connection(path: Path) -> None:
    """A daemon that has just started connects within seconds; a refusal is a refusal."""
    deadline = time.monotonic() + CONNECT_S
    while True:
        status = ask(path, "GET", "/status")
        command = status.get("command")
        if command is None or command["state"] not in ("connecting", "closed"):
            return
        if status["link"]["name"].startswith("replay:"):
            return  # it never will
        if time.monotonic() > deadline:
            return
        time.sleep(0.2)


def _require_ready(pilot: Pilot, wanted: dict[str, float], present: dict[str, float]) -> None:
    from groundstation.control.programme import AbortLimits

    unknown = [name for name in wanted if name not in present]
    if unknown:
        raise BadInputError(f"the craft has no parameter {', '.join(unknown)}; nothing was written")
    deadline = time.monotonic() + TELEMETRY_S
    while True:
        # zero thrust: looks at the telemetry without turning a motor
        answer = pilot.setpoint(0.0, 0.0, 0.0, 0)
        telemetry = answer["telemetry"]
        fresh = telemetry is not None and telemetry["age_s"] <= AbortLimits().silent_s
        if fresh and answer["link_state"] == "streaming":
            break
        if time.monotonic() < deadline:
            time.sleep(0.1)
            continue
        raise GroundStationError(
            f"no telemetry is coming in (link {answer['link_state']}); nothing was flown"
        )
    battery = telemetry["battery_v"]
    if battery is None or battery < LEAST_REST_V:
        raise GroundStationError(
            f"battery at {battery} V, {LEAST_REST_V} V at rest is the least; charge it"
        )


def _begin_recording(path: Path) -> dict[str, Any]:
    """A recording of this flight alone."""
    running = ask(path, "GET", "/status")["recording"]
    was_on = running["file"] is not None and running.get("state") not in ("off", "finished")
    if was_on:
        ask(path, "POST", "/record/stop")
    return {"was_on": was_on, **ask(path, "POST", "/record/start")}


def _write(pilot: Pilot, values: dict[str, float]) -> None:
    """Write parameters and require that the craft read back the same numbers."""
    import numpy as np

    if not values:
        return
    back = pilot.write(values)
    for name, value in values.items():
        if np.float32(back[name]) != np.float32(value):
            raise GroundStationError(
                f"{name}: wrote {value:g}, the craft says {back[name]:g}; nothing was flown"
            )


def _settle(pilot: Pilot, back: dict[str, float], aborted: str) -> None:
    """Put parameters back, and forget the note once that has worked."""
    try:
        _write(pilot, back)
    except (GroundStationError, KeyboardInterrupt) as error:
        say(f"the former gains could not be put back ({error}): pid fly --undo", error=True)
        return
    forget_changes()
    if back and aborted:
        say("the former gains are back", error=True)


def _stop(pilot: Pilot) -> None:
    """Zero thrust until the telemetry says that the motors stand, or is not heard any more."""
    deadline = time.monotonic() + STOPPED_S
    try:
        while time.monotonic() < deadline:
            telemetry = pilot.setpoint(0.0, 0.0, 0.0, 0)["telemetry"]
            if telemetry is None or not any(telemetry["motors"]):
                break
            time.sleep(0.05)
    except GroundStationError as error:
        say(f"stopping: {error}; the daemon's dead man stops the motors", error=True)


class _Clock:
    """Setpoints every 10 ms; what was missed is not made up for."""

    def __init__(self) -> None:
        self._next = time.monotonic()

    def wait(self) -> None:
        self._next = max(self._next + 0.01, time.monotonic() - 0.01)
        time.sleep(max(self._next - time.monotonic(), 0.0))


def _command(pilot: Pilot, programme: Programme, sticks: Source) -> str:
    """Take off, fly the programme, land; why it was aborted, or empty."""
    from groundstation.control.programme import RATE_HZ, reason_to_abort

    table = programme.setpoints()
    clock = _Clock()
    answer: dict[str, Any] = {}

    def send(roll: float, pitch: float, yaw: float, thrust: int) -> str:
        nonlocal answer
        answer = pilot.setpoint(roll, pitch, yaw, thrust)
        return reason_to_abort(answer)

    # take-off: until the human says so, or the pilot has had his time
    for tick in range(10**9):
        hands = sticks.read()
        if hands.stop:
            return "stopped by hand"
        reason = send(hands.roll_deg, hands.pitch_deg, hands.yaw_dps, hands.thrust)
        if reason and hands.thrust > MOTORS_ON:
            return reason
        if hands.begin and hands.thrust > MOTORS_ON and tick >= TAKE_OFF_S * RATE_HZ:
            break
        clock.wait()
    pilot.mark("pid fly programme")
    for roll, pitch, yaw in table.tolist():
        hands = sticks.read()
        if hands.stop or hands.thrust <= MOTORS_ON:
            return "stopped by hand"
        reason = send(
            roll + hands.roll_deg, pitch + hands.pitch_deg, yaw + hands.yaw_dps, hands.thrust
        )
        if reason:
            return reason
        clock.wait()
    pilot.mark("pid fly landing")
    return _land(pilot, sticks, clock, answer)


def _land(pilot: Pilot, sticks: Source, clock: _Clock, last: dict[str, Any]) -> str:
    """The stand-in sinks at a little less thrust than hovered; a human lands by hand."""
    from groundstation.control.programme import LANDING, RATE_HZ, reason_to_abort

    if isinstance(sticks, StandInPilot):
        if HOLD_HEIGHT in pilot.parameters():
            pilot.write({HOLD_HEIGHT: 0.0})
        hover = 65536.0 * sum(last["telemetry"]["motors"]) / 4.0
        for _ in range(round(DESCENT_S * RATE_HZ)):
            answer = pilot.setpoint(0.0, 0.0, 0.0, round(DESCENT * hover))
            reason = reason_to_abort(answer, LANDING)
            if reason:
                return reason
            if max(abs(rate) for rate in answer["telemetry"]["gyro_dps"]) > TOUCHED_DPS:
                break
            clock.wait()
        return ""
    say("the programme is flown: land", error=True)
    while True:
        hands = sticks.read()
        if hands.stop or hands.thrust <= MOTORS_ON:
            return ""
        reason = reason_to_abort(
            pilot.setpoint(hands.roll_deg, hands.pitch_deg, hands.yaw_dps, hands.thrust)
        )
        if reason:
            return reason
        clock.wait()


def _tell_left(left: dict[str, Any], present: dict[str, float]) -> None:
    when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(left["time"]))
    say(f"the flight of {when} on {left['uri']} was interrupted and left changed:", error=True)
    for name, value in left["saved"].items():
        say(
            f"  {name}: was {value:g}, written {left['written'].get(name, value):g},"
            f" is {present.get(name, float('nan')):g}",
            error=True,
        )
    say("'groundstation pid fly --undo' puts the former values back", error=True)


def _undo() -> None:
    left = changes_left()
    if left is None:
        typer.echo("nothing was left changed")
        return
    path = socket_path()
    _await_connection(path)
    with Pilot(path, CLIENT) as pilot:
        if pilot.lease["uri"] != left["uri"]:
            raise BadInputError(
                f"the changes were made on {left['uri']}, the daemon commands"
                f" {pilot.lease['uri']}; nothing was written"
            )
        _tell_left(left, pilot.parameters())
        _write(pilot, left["saved"])
    forget_changes()
    typer.echo("the former values are back: " + ", ".join(left["saved"]))


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
        from groundstation.control.flown_recording import analyse_recording
        from groundstation.dynamics.model import load_model
        from groundstation.recording.open_recording import open_recording

        if not Path(report["recording"]).exists():
            raise BadInputError(
                f"the flight was recorded to {report['recording']}, which is not here: the daemon"
                " runs in another folder; start pid fly there, or give it an absolute"
                " recording.folder"
            )
        loaded = None if model is None else load_model(model)
        recording = open_recording(Path(report["recording"]))
        flown = analyse_recording(recording, loaded, report["gains"], CLIENT)
        report["delay_s"], report["delay_spread_s"] = flown.delay_s, flown.spread_s
        report["axes"] = {one.axis: one.as_dict() for one in flown.axes}
        if html is not None:
            from groundstation.control.report import flight_page

            flight_page(flown, Path(report["recording"]).name, model).write(html)
    if as_json:
        typer.echo(json.dumps(report, indent=2))
        return
    typer.echo(f"recording: {report['recording']}")
    if flown is None:
        return
    from groundstation.control.report import flight_lines

    for line in flight_lines(flown):
        typer.echo(line)
