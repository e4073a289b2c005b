"""Flights and the model they are held against, for ``compare`` and ``discrepancy``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from groundstation import BadInputError
from groundstation.cli.model_files import fitted_model, open_one, with_reasons
from groundstation.paths import digest

if TYPE_CHECKING:
    from groundstation import Model, Recording, Run

MODEL = typer.Option(..., "--model", help="Model file, or the built-in 'thesis'.")
VEHICLE = typer.Option(
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
    from groundstation.recording.session import require_craft_of
    from groundstation.recording.soundness import rejected

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
