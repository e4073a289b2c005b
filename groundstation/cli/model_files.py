"""What the commands on models share: reading their input, never overwriting their output."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation.cli.terminal import show
from groundstation.errors import BadInputError
from groundstation.paths import taken

if TYPE_CHECKING:
    from groundstation.dynamics.model import Model
    from groundstation.identification.runs import Run
    from groundstation.recording.session import Recording

HTML = typer.Option(None, "--html", help="Write a report with figures to this new file.")
AS_JSON = typer.Option(False, "--json", help="Print JSON for programs.")
VEHICLE = typer.Option(
    None,
    "--vehicle",
    help="Vehicle profile: built in, or a TOML file (default: what the recordings say, else the"
    " model, else crazyflie1).",
)


def open_one(path: Path) -> Recording:
    from groundstation.recording.open_recording import open_recording

    return open_recording(path)


def runs_from(paths: Sequence[Path]) -> list[Run]:
    return runs_in([open_one(path) for path in paths])


def runs_in(recordings: Sequence[Recording]) -> list[Run]:
    from groundstation.identification.runs import runs_of

    return [run for one in recordings for run in runs_of(one.samples, one.path.name)]


def bridged_runs_in(recordings: Sequence[Recording]) -> list[Run]:
    """The same with short gaps bridged on straight lines, for what a radio's losses would cut to
    pieces."""
    from groundstation.identification.recordings import flights_of, without_gaps

    return [
        without_gaps(run)
        for one in recordings
        for run in flights_of(one.samples, one.path.name, least_s=1.0)
    ]


def motor_runs_in(recordings: Sequence[Recording]) -> list[Run]:
    """Runs of the motor bench as they are, flights with recorded rotor speeds bridged."""
    import numpy as np

    flown = any(np.isfinite(one.samples.rotor_rev_s).any() for one in recordings)
    return bridged_runs_in(recordings) if flown else runs_in(recordings)


def vehicle_of(recordings: Sequence[Recording], given: str | None) -> str | None:
    """The profile that the user gave, or the one that the recordings name; None where neither does.

    Raises BadInputError where they name several.
    """
    if given is not None:
        return given
    said = {one.path.name: one.metadata.get("vehicle", {}).get("profile") for one in recordings}
    labels = {label for label in said.values() if label is not None}
    if len(labels) > 1:
        listed = ", ".join(f"{name} of {label!r}" for name, label in said.items() if label)
        raise BadInputError(
            f"recordings of several vehicles ({listed}); fit one at a time, or, if a label is"
            " wrong, say --vehicle"
        )
    return labels.pop() if labels else None


def effect_names(effects: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in effects.split(",") if name.strip())


def model_before(model: str | None, vehicle: str | None) -> Model:
    """What a fit changes: a given model, or the base model of the profile.

    vehicle: the profile; None: the model's own, or crazyflie1 where no model is given.
    """
    import msgspec

    from groundstation.dynamics.model import load_model, vehicle_model
    from groundstation.dynamics.vehicle import BUILT_IN, load_vehicle

    if vehicle is None:
        return load_model(model) if model is not None else vehicle_model(load_vehicle("crazyflie1"))
    profile = load_vehicle(vehicle)
    before = load_model(model) if model is not None else vehicle_model(profile)
    return msgspec.structs.replace(
        before,
        vehicle=profile.name,
        vehicle_profile=None if vehicle in BUILT_IN else profile,
    )


def require_new(path: Path) -> None:
    """Raises BadInputError where a new file's name is taken or its folder is not there."""
    if path.exists():
        raise BadInputError(taken(path))
    if not path.absolute().parent.is_dir():
        raise BadInputError(f"{path}: there is no folder {path.parent}; nothing was done")


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
