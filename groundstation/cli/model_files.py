"""What commands on models share: input, output that is never overwritten, flights,
configuration.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation import BadInputError
from groundstation.cli.terminal import show, show_json
from groundstation.documents import decode_toml
from groundstation.paths import digest, taken, writing
from groundstation.service.config import ConfigSource, settings

if TYPE_CHECKING:
    from groundstation import Model, Recording, Run
    from groundstation.dynamics.model import Turning

# What the commands on models share: reading their input, never overwriting their output.


HTML = typer.Option(None, "--html", help="Write a report with figures to this new file.")
AS_JSON = typer.Option(False, "--json", help="Print JSON for programs.")
VEHICLE = typer.Option(
    None,
    "--vehicle",
    help="Vehicle profile: built in, or a TOML file (default: what the recordings say, else the"
    " model, else crazyflie1).",
)
MASS = typer.Option(
    None, "--mass", metavar="KG", help="What the craft weighed, where not as its profile says."
)
ATTITUDE = typer.Option(
    None,
    "--attitude",
    help="What turns the craft: arx or body (default: arx where 'fit arx' made the model).",
)
MASS_RANGE = 5.0
"""A craft weighs at most so many times, and at least one over so many, what its profile says."""


def open_one(path: Path) -> Recording:
    """A recording for an analysis: what is not believed of it is missing."""
    from groundstation.recording.formats import open_for_analysis

    return open_for_analysis(path)


def tell_rejected(recordings: Sequence[Recording]) -> None:
    """On stderr, what of recordings was taken as missing."""
    from groundstation.recording.quality import rejected

    for one in recordings:
        for line in rejected(one):
            show(line, error=True)


@contextlib.contextmanager
def with_reasons(recordings: Sequence[Recording], where: str = "") -> Iterator[None]:
    """A refusal, behind ``where``, also says what of the recordings was taken as missing: it may be
    why."""
    from groundstation.recording.quality import rejected

    try:
        yield
    except BadInputError as error:
        lines = "; ".join(line for one in recordings for line in rejected(one))
        if not (lines or where):
            raise
        reasons = f" ({lines})" if lines else ""
        raise type(error)(f"{where}{error}{reasons}") from error


def runs_from(paths: Sequence[Path]) -> list[Run]:
    recordings = [open_one(path) for path in paths]
    tell_rejected(recordings)
    return runs_in(recordings)


def runs_in(recordings: Sequence[Recording]) -> list[Run]:
    from groundstation import runs_of

    return [run for one in recordings for run in runs_of(one.samples, one.path.name)]


def bridged_runs_in(recordings: Sequence[Recording]) -> list[Run]:
    """The same with short gaps bridged, for what a radio's losses would cut to pieces."""
    from groundstation.identification.runs import bridged

    return [run for one in recordings for run in bridged(one.samples, one.path.name, least_s=1.0)]


def motor_runs_in(recordings: Sequence[Recording]) -> list[Run]:
    from groundstation.identification.motor.workflow import motor_runs

    return motor_runs([(one.samples, one.path.name) for one in recordings])


def fitted_model(source: str, *, attitude: bool = False) -> Model:
    """A model whose body was fitted; what else in it was not is told on stderr.

    attitude: ARX polynomials of all three angles do as well.

    Raises BadInputError for a body of a profile.
    """
    from groundstation import load_model
    from groundstation.dynamics.model import origin_notes, require_fitted_body

    model = load_model(source)
    if not (attitude and model.arx is not None and {"roll", "pitch", "yaw"} <= set(model.arx)):
        require_fitted_body(model, source)
    for line in origin_notes(model):
        show(f"{source}: {line}", error=True)
    return model


def told_turning(model: Model, said: str | None) -> Turning:
    """What of a model turns the craft; ARX polynomials are told on stderr.

    Raises BadInputError for a choice that the model does not leave.
    """
    from groundstation.dynamics.model import arx_labels, turning_of

    turning = turning_of(model, said)
    if turning == "arx":
        turns = f"the craft turns by {arx_labels(model)}; thrust is the body's"
        show(f"{turns} (--attitude body)", error=True)
    return turning


def effect_names(effects: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in effects.split(",") if name.strip())


def model_before(model: Model | None, vehicle: str | None, mass_kg: float | None = None) -> Model:
    """What a fit changes: a given model, or the base model of the profile.

    vehicle: the profile; None: the model's own, or crazyflie1 where no model is given. mass_kg:
    of the craft that flew, where it differs from the profile's.

    Raises BadInputError for a mass that is none, or hardly in kg.
    """
    import msgspec

    from groundstation import load_vehicle, vehicle_model
    from groundstation.dynamics.model import model_vehicle
    from groundstation.dynamics.vehicle import BUILT_IN

    if vehicle is not None:
        profile = load_vehicle(vehicle)
    else:
        profile = load_vehicle("crazyflie1") if model is None else model_vehicle(model)
    weighed = profile
    if mass_kg is not None:
        if not profile.mass_kg / MASS_RANGE <= mass_kg <= profile.mass_kg * MASS_RANGE:
            raise BadInputError(
                f"--mass {mass_kg:g}: in kg, and {profile.name} weighs {profile.mass_kg:g} kg"
            )
        weighed = msgspec.structs.replace(profile, mass_kg=mass_kg)
    before = model if model is not None else vehicle_model(weighed)
    if vehicle is None and mass_kg is None:
        return before
    return msgspec.structs.replace(
        before,
        vehicle=weighed.name,
        vehicle_profile=None if weighed == BUILT_IN.get(weighed.name) else weighed,
    )


def require_new(*paths: Path | None) -> None:
    """Raises BadInputError where a new file's name is taken, its folder is not there, or rerun,
    which writes an .rrd, is not installed."""
    from groundstation.rerun_log.channels import require_rerun

    for path in filter(None, paths):
        if path.exists():
            raise BadInputError(taken(path))
        if not path.absolute().parent.is_dir():
            raise BadInputError(f"{path}: there is no folder {path.parent}; nothing was done")
        if path.suffix.lower() == ".rrd":
            require_rerun(f"{path}: an .rrd file")


def answer(
    as_json: bool,
    value: Any,
    lines: Iterable[str] = (),
    *written: Path | None,
    indent: int | None = 2,
) -> None:
    """What a command ends with: ``value`` for programs, or lines and the new files for people."""
    if as_json:
        show_json(value, indent)
        return
    for line in lines:
        show(line)
    say_written(*written)


def say_written(*paths: Path | None) -> None:
    """One line for each new file."""
    for path in filter(None, paths):
        show(f"written: {path}")


def write_table(path: Path, head: str, table: Any) -> None:
    import numpy as np

    with writing(path, BadInputError):
        np.savetxt(path, table, fmt="%.6f", delimiter=",", header=head, comments="")


# Flights and the model they are held against, for ``compare`` and ``discrepancy``.


MODEL = typer.Option(..., "--model", help="Model file, or the built-in 'thesis'.")
FLOWN_VEHICLE = typer.Option(
    None, "--vehicle", help="Vehicle profile of the recordings (default: the model's)."
)


def model_for(source: str, vehicle: str | None) -> Model:
    """The model, made sure to be one of this vehicle. Raises BadInputError otherwise."""
    import msgspec

    from groundstation import load_vehicle
    from groundstation.dynamics.vehicle import BUILT_IN
    from groundstation.recording.session import other_vehicle

    model = fitted_model(source)
    if vehicle is None:
        return model
    profile = load_vehicle(vehicle)
    if profile.name != model.vehicle:
        raise other_vehicle(f"--vehicle {vehicle}", profile.name, model)
    if vehicle in BUILT_IN:
        return model
    return msgspec.structs.replace(model, vehicle_profile=profile)


@dataclass(frozen=True, slots=True)
class Flights:
    """One recording: its flights, lost rows as NaN. is_aided: its angles are those of a filter that
    is told how fast the craft moves."""

    name: str
    runs: list[Run]
    is_aided: bool = False


def read_flights(
    paths: Sequence[Path], model: Model, vehicle: str | None
) -> tuple[list[Flights], list[str]]:
    """Each recording, opened once; those in which nothing lasts 5 s have no runs, and are told in
    words.

    Raises BadInputError where a recording says that it is of another vehicle than the model's,
    unless ``vehicle`` says the contrary, and where nothing lasts 5 s in any.
    """
    from groundstation.identification.runs import flights_of_each, renewal_notes
    from groundstation.recording.quality import rejected
    from groundstation.recording.session import require_craft_of

    recordings = [open_one(path) for path in paths]
    if vehicle is None:
        for one in recordings:
            require_craft_of(one, model)
    with with_reasons(recordings):
        runs, left_out = flights_of_each((one.samples, one.path.name) for one in recordings)
    left_out = [*(line for one in recordings for line in rejected(one)), *left_out]
    left_out += [line for one in recordings for line in renewal_notes(one.samples, one.path.name)]
    return [
        Flights(one.path.name, its, _is_aided(one))
        for one, its in zip(recordings, runs, strict=True)
    ], left_out


MOVES_M_S = 0.01
"""Standard deviation of a velocity that something measures; it stays 0 where nothing does."""


def _is_aided(recording: Recording) -> bool:
    """By the velocity that the firmware's filter said to a daemon."""
    import numpy as np

    from groundstation.links.crazyflie_connection import TABLE

    table = recording.tables.get(TABLE)
    velocity = None if table is None else table.columns.get("stateEstimate.vx")
    return velocity is not None and float(np.nanstd(velocity.astype(float))) > MOVES_M_S


FILTER = "position_aided_lean"
STRENGTH, TIME_S = 1.0, 0.81
"""Of the firmware's Kalman filter behind a Flow deck, 0.5 m above the floor: all that pushes the
craft across its axis is taken for a lean, by a filter whose poles are 0.95 +- 0.78i a second."""


def with_filter(model: Model, flights: Sequence[Flights]) -> tuple[Model, list[str]]:
    """The given model of a craft of today with what its own filter makes of the angles, where a
    flight shows that it flew; it is fitted along, and no name is looked for in it. In words."""
    import msgspec

    from groundstation.dynamics.model import EffectTerm, Estimate, model_vehicle

    known = {term.name for term in model.effects}
    is_told = FILTER in known or "attitude_filter_lean" in known
    if is_told or model_vehicle(model).firmware != "2.x" or not all(f.is_aided for f in flights):
        return model, []
    term = EffectTerm(
        FILTER, {"strength": Estimate(STRENGTH), "time_s": Estimate(TIME_S, unit="s")}
    )
    said = "the angles are those of the craft's own filter, which takes drag for a lean: that is"
    said += f" in the given model ({FILTER}), not among what is looked for"
    return msgspec.structs.replace(model, effects=(*model.effects, term)), [said]


def require_apart(recordings: Sequence[Path], validate: Sequence[Path]) -> None:
    """Raises BadInputError where one flight is given twice, under whatever name.

    Fitted twice it would count as two that agree; held out as well it would prove nothing.
    """
    seen: dict[str, Path] = {}
    for path in (*recordings, *validate):
        if not path.is_file():
            continue  # whoever opens it says why it cannot be read
        try:
            content = digest(path)
        except OSError:
            continue
        if content in seen:
            what = "given twice" if path == seen[content] else f"the same as {seen[content]}"
            raise BadInputError(
                f"{path}: {what}; give each recording once, and to --validate only those that are"
                " not fitted"
            )
        seen[content] = path


# ``groundstation config``: what can be set, and what is set.


def config(
    file: Path | None = typer.Option(None, "--config", help="TOML configuration file."),
    assign: list[str] = typer.Option(
        [], "--set", metavar="KEY=VALUE", help="Any key, as on the command line of 'run'."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Show every key, its value and its default. A file is overridden by the environment
    (GROUNDSTATION_RECORDING_FOLDER for recording.folder), and that by the command line.

    Example: [bold]groundstation config --config station.toml[/bold]
    """
    found = settings(ConfigSource(file, assignments(assign)).load())
    keys = {
        each.name: {"value": each.value, "default": each.default, "text": each.text}
        for each in found
    }
    lines, table = list[str](), ""
    for each in found:
        if isinstance(each.value, dict):
            lines += ["", f"# {each.text}", f"[{each.name}]", *_assigned(each.value)]
            continue
        place, _, key = each.name.rpartition(".")
        if place != table:
            table = place
            lines += ["", f"[{table}]"]
        usual = "" if each.value == each.default else f" (default {_toml(each.default)})"
        lines.append(f"{key + ' = ' + _toml(each.value):<32}  # {each.text}{usual}")
    answer(as_json, keys, lines)


def assignments(given: list[str]) -> dict[str, Any]:
    """``KEY=VALUE`` of the command line as key -> value. Raises a usage error for another form."""
    from groundstation.service.config import FORMER, former, keys, todays_name

    known = keys()
    values: dict[str, Any] = {}
    for text in given:
        key, equals, value = text.partition("=")
        if key in FORMER:
            raise typer.BadParameter(former(key), param_hint="'--set'")
        key = todays_name(key, "--set ")
        if not equals or key not in known:
            raise typer.BadParameter(
                f"{text!r}: give KEY=VALUE with a KEY of 'groundstation config'",
                param_hint="'--set'",
            )
        try:
            values[key] = decode_toml(f"value = {value}".encode(), dict[str, Any])["value"]
        except ValueError:  # no TOML: the text itself
            values[key] = value
    return values


def _assigned(table: dict[str, Any]) -> Iterator[str]:
    for key, value in table.items():
        plain = key.replace("_", "a").isalnum() and key.isascii()
        yield f"{key if plain else json.dumps(key)} = {_toml(value)}"


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(_assigned(value)) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)
