"""What the commands on models share: reading their input, never overwriting their output."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation import BadInputError
from groundstation.cli.terminal import show
from groundstation.paths import taken

if TYPE_CHECKING:
    from groundstation import Model, Recording, Run
    from groundstation.dynamics.model import Turning

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
    from groundstation.recording.soundness import rejected

    for one in recordings:
        for line in rejected(one):
            show(line, error=True)


@contextlib.contextmanager
def with_reasons(recordings: Sequence[Recording], where: str = "") -> Iterator[None]:
    """A refusal, behind ``where``, also says what of the recordings was taken as missing: it may be
    why."""
    from groundstation.recording.soundness import rejected

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


def write_new(path: Path, text: str) -> None:
    """Write a new file. Raises BadInputError where there is one, or it cannot be written."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise BadInputError(taken(path)) from error
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror}") from error


def require_new(path: Path) -> None:
    """Raises BadInputError where a new file's name is taken, its folder is not there, or rerun,
    which writes an .rrd, is not installed."""
    from groundstation.rerun_log.installed import require_rerun

    if path.exists():
        raise BadInputError(taken(path))
    if not path.absolute().parent.is_dir():
        raise BadInputError(f"{path}: there is no folder {path.parent}; nothing was done")
    if path.suffix.lower() == ".rrd":
        require_rerun(f"{path}: an .rrd file")


def say_written(*paths: Path | None) -> None:
    """One line for each new file."""
    for path in paths:
        if path is not None:
            show(f"written: {path}")


def write_table(path: Path, head: str, table: Any) -> None:
    import numpy as np

    try:
        np.savetxt(path, table, fmt="%.6f", delimiter=",", header=head, comments="")
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror}") from error
