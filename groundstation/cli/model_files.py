"""What the commands on models share: reading their input, never overwriting their output."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation.errors import BadInputError

if TYPE_CHECKING:
    from groundstation.dynamics.model import Model
    from groundstation.identification.runs import Run
    from groundstation.recording.session import Recording

AS_JSON = typer.Option(False, "--json", help="Print JSON for programs.")
VEHICLE = typer.Option("crazyflie1", help="Vehicle profile: built in, or a TOML file.")


def open_one(path: Path) -> Recording:
    from groundstation.recording.open_recording import open_recording

    return open_recording(path)


def runs_from(paths: Sequence[Path]) -> list[Run]:
    from groundstation.identification.runs import runs_of

    return [run for path in paths for run in runs_of(open_one(path).samples, path.name)]


def effect_names(effects: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in effects.split(",") if name.strip())


def model_before(model: str | None, vehicle: str) -> Model:
    """What a fit changes: a given model, or the base model of the profile."""
    import msgspec

    from groundstation.dynamics.model import load_model, vehicle_model
    from groundstation.dynamics.vehicle import BUILT_IN, load_vehicle

    profile = load_vehicle(vehicle)
    before = load_model(model) if model is not None else vehicle_model(profile)
    return msgspec.structs.replace(
        before,
        vehicle=profile.name,
        vehicle_profile=None if vehicle in BUILT_IN else profile,
    )


def require_new(path: Path) -> None:
    if path.exists():
        raise BadInputError(f"{path} exists already; nothing is ever overwritten")
    if not path.absolute().parent.is_dir():
        raise BadInputError(f"{path}: there is no folder {path.parent}; nothing was done")


def write_table(path: Path, head: str, table: Any) -> None:
    import numpy as np

    try:
        np.savetxt(path, table, fmt="%.6f", delimiter=",", header=head, comments="")
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror}") from error
