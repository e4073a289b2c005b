"""Which effects one craft's model is missing, from several of its flights together."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from groundstation.fleet.facts import fetched
from groundstation.fleet.gather import with_reason
from groundstation.fleet.parts import Row

if TYPE_CHECKING:
    from groundstation.discrepancy.engine import Discrepancy
    from groundstation.dynamics.model import Model
    from groundstation.identification.runs import Run

COLUMNS = {
    "craft": "text",
    "settings": "text",
    "fitted": "texts",
    "held_out": "texts",
    "verdict": "text",
    "effects": "texts",
    "parameters": "texts",
    "values": "numbers",
    "stderrs": "numbers",
    "units": "texts",
    "changed": "texts",
    "gap_before": "number",
    "gap_after": "number",
    "left": "texts",
    "to_fly": "texts",
    "warnings": "texts",
    "model": "text",
    "reason": "text",
}
"""Of the catalogue's table ``effects``. fitted, held_out: addresses of whole flights. effects:
names in the order of joining; parameters, values, stderrs, units: of all of them, by place,
parameters as ``effect.parameter``. changed: constants of the given model that moved, in words.
to_fly: effects that these flights cannot show, with the manoeuvre. warnings: what was left out of
the flights, and what else the search warns of. model: the improved one, as a model file holds it.
reason: why nothing was told."""
KEY = "craft"


@dataclass(frozen=True, slots=True)
class CraftFlights:
    """A craft's flights, by address. settings: what a row says that it was computed with."""

    craft: str
    fitted: tuple[str, ...]
    held_out: tuple[str, ...]
    settings: str


def searching(model: Model | None, vehicle: str | None) -> partial[Row]:
    """The search on one craft, for a worker. model: what every craft is held against; None: each
    craft's own fit to the flights that are fitted. vehicle: as for ``fleet fit``."""
    return partial(search_craft, model=model, vehicle=vehicle)


def search_craft(flights: CraftFlights, model: Model | None, vehicle: str | None) -> Row:
    """A row of the table ``effects``. Never raises for what files hold: that is its ``reason``."""

    def told() -> Row:
        with ExitStack() as files:
            fit_on, held = (
                [files.enter_context(fetched(one)) for one in addresses]
                for addresses in (flights.fitted, flights.held_out)
            )
            return _told(_searched(fit_on, held, model, vehicle))

    return with_reason(row_of(flights), told)


def row_of(flights: CraftFlights) -> Row:
    """A row of the table ``effects`` that tells nothing yet."""
    row: Row = dict.fromkeys(COLUMNS)
    return row | {
        KEY: flights.craft,
        "settings": flights.settings,
        "fitted": list(flights.fitted),
        "held_out": list(flights.held_out),
    }


def _searched(
    fit_on: Sequence[Path], held: Sequence[Path], model: Model | None, vehicle: str | None
) -> Discrepancy:
    from groundstation.discrepancy.engine import find_discrepancy
    from groundstation.identification.runs import flights_of_each, without_gaps
    from groundstation.recording.formats import open_for_analysis
    from groundstation.recording.session import require_craft_of, vehicle_of

    opened = [[open_for_analysis(path) for path in paths] for paths in (fit_on, held)]
    groups = [
        flights_of_each((one.samples, one.path.name) for one in recordings) for recordings in opened
    ]
    runs: list[list[list[Run]]] = [one for one, _ in groups]
    if model is None:
        name = vehicle_of([*opened[0], *opened[1]], vehicle) or "crazyflie1"
        bridged, rest = (
            [without_gaps(run) for flight in flights for run in flight] for flights in runs
        )
        model = _own_fit(bridged, rest, name)
    elif vehicle is None:
        for one in (*opened[0], *opened[1]):
            require_craft_of(one, model)
    left_out = [words for _, some in groups for words in some]
    return find_discrepancy(runs[0], model, runs[1], left_out=left_out)


def _own_fit(fit_on: Sequence[Run], held: Sequence[Run], vehicle: str) -> Model:
    """The craft's body on the profile's motors, without any effect."""
    from groundstation.dynamics.model import model_vehicle, vehicle_model
    from groundstation.dynamics.vehicle import load_vehicle
    from groundstation.identification.body.workflow import identify_body
    from groundstation.identification.fit_record import require_results

    before = vehicle_model(load_vehicle(vehicle))
    found = identify_body(fit_on, held, before, model_vehicle(before))
    require_results(found.account, before, model_vehicle(before))
    return found.model


def _told(found: Discrepancy) -> Row:
    """The outcome in the table's columns."""
    import msgspec

    from groundstation.discrepancy.acceptance import in_words
    from groundstation.discrepancy.proof import what_is_left

    findings, proof = found.findings, found.proof
    every = [
        (f"{effect.name}.{name}", estimate)
        for effect in findings.effects
        for name, estimate in effect.parameters.items()
    ]
    return {
        "verdict": findings.verdict.value,
        "effects": [effect.name for effect in findings.effects],
        "parameters": [name for name, _ in every],
        "values": [one.value for _, one in every],
        "stderrs": [one.stderr for _, one in every],
        "units": [one.unit for _, one in every],
        "changed": [in_words(change) for change in findings.base_changes],
        "gap_before": proof.before.gap,
        "gap_after": proof.after.beside(proof.before),
        "left": [one.words for one in what_is_left(proof.after)],
        "to_fly": sorted({f"{one.name}: {one.manoeuvre}" for one in findings.not_shown}),
        "warnings": list(findings.warnings),
        "model": msgspec.json.encode(findings.model).decode(),
    }
