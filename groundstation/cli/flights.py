"""Flights and the model they are held against, for ``compare`` and ``discrepancy``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from groundstation import BadInputError
from groundstation.cli.model_files import fitted_model, open_one
from groundstation.paths import digest

if TYPE_CHECKING:
    from groundstation import Model, Run

MODEL = typer.Option(..., "--model", help="Model file, or the built-in 'thesis'.")
VEHICLE = typer.Option(
    None, "--vehicle", help="Vehicle profile of the recordings (default: the model's)."
)


def model_for(source: str, vehicle: str | None) -> Model:
    """The model, made sure to be one of this vehicle. Raises BadInputError otherwise."""
    import msgspec

    from groundstation import load_vehicle
    from groundstation.dynamics.vehicle import BUILT_IN
    from groundstation.recording.craft_family import other_vehicle

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
    """One recording: its flights, lost rows as NaN."""

    name: str
    runs: list[Run]


def read_flights(
    paths: Sequence[Path], model: Model, vehicle: str | None
) -> tuple[list[Flights], list[str]]:
    """Each recording, opened once; those in which nothing lasts 5 s have no runs, and are told in
    words.

    Raises BadInputError where a recording holds what cannot be, or says that it is of another
    vehicle than the model's, unless ``vehicle`` says the contrary, and where nothing lasts 5 s in
    any.
    """
    from groundstation.identification.recordings import flights_of_each, renewal_notes
    from groundstation.recording.craft_family import require_craft_of
    from groundstation.recording.plausibility import require_possible

    recordings = [open_one(path) for path in paths]
    for one in recordings:
        require_possible(one)
    if vehicle is None:
        for one in recordings:
            require_craft_of(one, model)
    runs, left_out = flights_of_each((one.samples, one.path.name) for one in recordings)
    left_out += [line for one in recordings for line in renewal_notes(one.samples, one.path.name)]
    return [
        Flights(one.path.name, its) for one, its in zip(recordings, runs, strict=True)
    ], left_out


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
