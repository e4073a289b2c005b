"""``pid fly``: gains and a programme on a craft, by the daemon's control API."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation import BadInputError, Pilot, socket_path
from groundstation.cli.flying import (
    STORE,
    await_connection,
    clear_gains,
    require_consent,
    require_ended,
    require_height,
    require_ready,
    require_standing,
    require_storing,
    store_gains,
)
from groundstation.cli.model_files import AS_JSON, fitted_model, require_new, say_written
from groundstation.cli.pid_manoeuvres import (
    HOLD_HEIGHT,
    NOMINAL_V,
    Source,
    StandInPilot,
    height_of,
    open_sticks,
)
from groundstation.cli.terminal import say, show, show_json
from groundstation.service.client import ask

if TYPE_CHECKING:
    from groundstation import Recording
    from groundstation.cli.flying import Ended, Interrupts
    from groundstation.control.firmwares import Release
    from groundstation.control.programme import Programme
    from groundstation.control.step_analysis import Flown

# What ``pid fly`` is given: gains, a model, and the firmware that they are for.


@dataclass(frozen=True, slots=True)
class Whose:
    """The files of gains and of the model, and the firmware that the user says they are for."""

    gains: Path | None
    model: str | None
    said: str | None

    def wanted(self) -> dict[str, float]:
        """The gains. Raises BadInputError for what is wrong with any: better known before a
        flight."""
        from groundstation.control.firmware_loop import plant_of_model
        from groundstation.control.firmwares import require_release

        wanted = {} if self.gains is None else _firmware_gains(self.gains)
        if self.said is not None:
            require_release(self.said)
        if self.model is not None:
            plant_of_model(fitted_model(self.model), release=self.said)
        return wanted

    def require(self, craft: str, uri: str) -> Release | None:
        """The firmware of the craft that calls its own ``craft`` (empty: it does not say).

        Raises BadInputError where gains or model are another's: the same parameters mean other
        numbers there.
        """
        from groundstation import load_model
        from groundstation.control.firmware_loop import require_gains_of
        from groundstation.control.firmwares import firmware_of_vehicle, require_release
        from groundstation.dynamics.model import model_vehicle

        if not (craft or self.said):
            if self.gains is None and self.model is None:
                return None
            raise BadInputError(
                f"{uri} does not say whose loops it flies; say --firmware 2014 or --firmware 2.x"
            )
        if craft and self.said and craft != self.said:
            raise BadInputError(f"--firmware {self.said}: {uri} flies {craft}; nothing was written")
        release = require_release(craft or str(self.said))
        if self.gains is not None:
            require_gains_of(self.gains, release, uri, said=self.said)
        if self.model is not None and self.said is None:
            vehicle = model_vehicle(load_model(self.model))
            if firmware_of_vehicle(vehicle).name != release:
                raise BadInputError(
                    f"model {self.model}: a {vehicle.name} flies {vehicle.firmware}, {uri} flies"
                    f" {release}: not of this craft, or say --firmware {release}"
                )
        return release


def _firmware_gains(path: Path) -> dict[str, float]:
    """The firmware's gains of a file. Raises BadInputError for others, which cannot be flown."""
    from groundstation import PidGains, load_gains
    from groundstation.control.firmware_loop import require_gains

    wanted: dict[str, float] = {}
    for name, value in load_gains(path).items():
        if isinstance(value, PidGains):
            raise BadInputError(
                f"gains {path}: the thesis's form cannot be flown, only the firmware's"
            )
        wanted[name] = value
    require_gains(wanted, f"gains {path}")
    return wanted


# ``pid fly``: gains and a programme on a craft, by the daemon's control API.


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
    hold: float = typer.Option(0.7, help="How long each level is held, s."),
    rest: float = typer.Option(1.0, help="Rest between manoeuvres, s."),
    repeat: int = typer.Option(8, help="Manoeuvres an axis; more of them, less noise."),
    firmware: str | None = typer.Option(
        None,
        "--firmware",
        help="2014 or 2.x, where neither file nor craft say whose the gains are.",
    ),
    thrust: str = THRUST,
    restore: bool = typer.Option(False, "--restore", help="Put the former gains back after it."),
    store: bool = STORE,
    undo: bool = typer.Option(False, "--undo", help="Put former gains back, clear stored ones."),
    rehearse: bool = typer.Option(
        False, "--rehearse", help="Fly it in software with --model; no craft is touched."
    ),
    dry_run: bool = typer.Option(False, "--dry-run", help="Show what would be flown."),
    yes: bool = typer.Option(False, "--yes", help="Do not ask before a real craft flies."),
    html: Path | None = typer.Option(None, "--html", help="Write a report to this new file."),
    as_json: bool = AS_JSON,
) -> None:
    """Fly gains through steps or doublets, and compare with the prediction.

    A client of a running daemon with a command link ('groundstation run --command ...'). Ctrl-C
    lands a craft that holds its height, a second one stops its motors.

    Example: [bold]groundstation pid fly --gains gains.toml --model body.json --restore[/bold]
    """
    if html is not None:
        require_new(html)
    planned = _planned(programme, axis, amplitude, yaw_rate, hold, rest, repeat)
    whose = Whose(gains, model, firmware)
    wanted = whose.wanted()
    if dry_run:
        _show(planned, wanted, as_json)
        return
    if rehearse:
        _rehearse(planned, wanted, model, height_of(thrust or "height"), as_json)
        return
    if undo:
        _undo()
        return
    report = _flight(planned, wanted, whose, restore, store, thrust, yes)
    require_ended(report, "flight")
    _judge(report, planned, model, html, as_json)


def _planned(shape: Any, axes: list[str] | None, *more: Any) -> Programme:
    """Raises BadInputError for one that should not be flown."""
    from groundstation.control.programme import Programme, require_flyable
    from groundstation.telemetry.arrays import AXES

    planned = Programme(shape, tuple(axes or AXES), *more)
    require_flyable(planned)
    return planned


def _show(programme: Programme, wanted: dict[str, float], as_json: bool) -> None:
    from groundstation.control.programme import BEYOND_M

    plan = {
        **programme.as_dict(),
        **{
            name: getattr(programme, name)
            for name in ("seconds", "reach_m", "held_seconds", "held_reach_m")
        },
    }
    if as_json:
        show_json({"programme": plan, "gains": wanted})
        return
    show(
        f"{programme.repeats} {programme.shape}s an axis ({', '.join(programme.axes)}):"
        f" {programme.angle_deg:g} deg, yaw {programme.yaw_dps:g} deg/s,"
        f" held {programme.hold_s:g} s"
    )
    show(
        f"with a Flow deck: about {programme.held_seconds:.0f} s; it returns after each"
        f" manoeuvre, stays within {programme.held_reach_m:.1f} m of its take-off, and lands"
        f" {BEYOND_M:g} m beyond that"
    )
    show(
        f"without: {programme.seconds:.0f} s; one manoeuvre carries it {programme.reach_m:.1f} m,"
        " nothing brings it back: a human must"
    )
    for name, value in wanted.items():
        show(f"  {name} = {value:g}")


def _rehearse(
    programme: Programme,
    wanted: dict[str, float],
    model: str | None,
    height_m: float | None,
    as_json: bool,
) -> None:
    from groundstation.cli.learn_flights import rehearse
    from groundstation.control.report import flight_lines

    if model is None or height_m is None:
        raise BadInputError("--rehearse: give the identified craft, --model, and --thrust height")
    reach_m, measures = programme.held_reach_m, programme.shape != "level"
    told, steps = rehearse(programme, wanted, model, height_m, reach_m, measures)
    if as_json:
        axes = {} if steps is None else {one.axis: one.as_dict() for one in steps.axes}
        show_json({"rehearsal": told, "gains": wanted, "axes": axes})
        return
    show(
        f"rehearsed in software, {told['seconds']:.0f} s: it stayed within"
        f" {told['farthest_m']:.1f} m of its take-off, flew {told['top_m_s']:.1f} m/s at most,"
        f" leaned {told['lean_deg']:.0f} deg at most, and landed"
    )
    for line in [] if steps is None else flight_lines(steps):
        show(line)


def _flight(
    programme: Programme,
    wanted: dict[str, float],
    whose: Whose,
    restore: bool,
    store: bool,
    thrust: str,
    yes: bool,
) -> dict[str, Any]:
    """Everything that touches the craft; what happened."""
    from groundstation.cli.flying import Changes, commanded, fly_recorded, stops_begun

    path = socket_path()
    await_connection(path)
    with commanded(CLIENT, stops_begun(path)) as pilot:
        lease = pilot.lease
        uri, software = lease["uri"], lease["software"]
        release = whose.require(lease["firmware"], uri)
        if thrust == "stand-in" and not software:
            raise BadInputError(f"--thrust stand-in: {uri} is a real craft; a human gives thrust")
        before = pilot.parameters()
        Changes.of(before, wanted)
        tells_battery = require_ready(pilot, needs_battery=False)["battery_v"] is not None
        require_storing(pilot, store, restore=restore)
        if thrust.startswith("height"):
            require_height(pilot, f"--thrust {thrust}: ")
        usual = "height" if lease["holds_height"] else "stand-in" if software else "keyboard"
        height_m = height_of(thrust or usual)
        with nullcontext() if height_m else open_sticks(thrust or usual) as sticks:
            if not software and not yes:
                require_consent(pilot, f"{uri}: clear of people, ready to fly?", "not flown")
            require_standing(pilot)
            holds = HOLD_HEIGHT in before and isinstance(sticks, StandInPilot)
            changed = {**wanted, HOLD_HEIGHT: 1.0} if holds else wanted
            stays = frozenset() if restore else frozenset(wanted)
            changes = Changes.of(before, changed, stays=stays)
            flown = before | wanted
            details = {
                "programme": programme.as_dict(),
                "gains": wanted,
                "saved": changes.former,
                "firmware": release,
                "flown": {k: v for k, v in flown.items() if k.startswith("pid_")},
            }
            fly = _way_to_fly(pilot, programme, height_m, sticks, tells_battery)
            report = fly_recorded(pilot, changes, fly, f"{CLIENT} begins", **details)
        keeps = store and not report.ended.why
        done = f"flown and recorded to {report.recording}"
        stored = store_gains(pilot, done) if keeps else []
    return {
        "aborted": report.ended.why,
        "motors": report.ended.motors,
        "restored": report.restored,
        "stored": stored,
        "recording": report.recording,
        "gains": details["flown"],
        "firmware": release,
    }


def _way_to_fly(
    pilot: Pilot,
    programme: Programme,
    height_m: float | None,
    sticks: Source | None,
    tells_battery: bool,
) -> Callable[[Interrupts], Ended]:
    """By the height that the craft holds, or by somebody's thrust."""
    from groundstation.cli.flying import Room, fly_by_height
    from groundstation.cli.pid_manoeuvres import fly_by_hand

    uri = pilot.lease["uri"]
    if sticks is not None:
        say(f"{uri}: {sticks.help}; Ctrl-C stops the motors", error=True)
        return lambda signals: fly_by_hand(
            pilot, programme, sticks, signals, tells_battery=tells_battery
        )
    assert height_m is not None
    floor_m = pilot.setpoint(0.0, 0.0, 0.0, 0)["height_m"] or 0.0
    room = Room(height_m, floor_m, programme.held_reach_m)
    say(f"{uri}: the craft holds {height_m:g} m by itself; Ctrl-C lands it", error=True)
    return lambda signals: fly_by_height(
        pilot, programme, room, signals, tells_battery=tells_battery
    )


def _undo() -> None:
    from groundstation.cli.flying import write_parameters

    path = socket_path()
    await_connection(path)
    restored = ask(path, "POST", "/command/restore")["values"]
    if restored:
        show("the former values are back: " + ", ".join(restored))
    cleared: dict[str, float] = {}
    command = ask(path, "GET", "/status")["command"]
    if command is not None and command["stores"]:
        with Pilot(path, CLIENT) as pilot:
            cleared = clear_gains(pilot)
            write_parameters(pilot, cleared)
    if cleared:
        show("stored gains cleared, the stock ones are back: " + ", ".join(cleared))
    if not (restored or cleared):
        show("nothing was left changed")


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
        from groundstation import load_model
        from groundstation.control.step_analysis import analyse_recording
        from groundstation.recording.formats import open_for_analysis

        if not Path(report["recording"]).exists():
            raise BadInputError(
                f"the flight was recorded to {report['recording']}, which is not there: start"
                " pid fly where it can read the daemon's recordings"
            )
        loaded = None if model is None else load_model(model)
        recording = open_for_analysis(Path(report["recording"]))
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
    if report["stored"]:
        show("stored on the craft: " + ", ".join(report["stored"]))
    if flown is None:
        return
    from groundstation.control.report import flight_lines

    for line in flight_lines(flown):
        show(line)
    say_written(html)
