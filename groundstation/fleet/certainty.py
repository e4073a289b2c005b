"""How well flights tell each constant: expected from the Jacobian when a recording is read, known
when it is fitted."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundstation.errors import BadInputError
from groundstation.fleet.parts import Row

if TYPE_CHECKING:
    from groundstation.identification.runs import Run
    from groundstation.recording.session import Recording

AXES = ("c0", "c1", "c2")
TOLD = (*AXES, "thrust_per_mass", "motor_pace")
"""Of ``flight_excitation``."""
PERCENT = {name: f"{name}_expected_percent" for name in TOLD}
COLUMNS = {**dict.fromkeys(PERCENT.values(), "number"), "not_expected": "text"}
"""Of the catalogue's table ``recordings``: the standard error that a fit of this flight may expect,
in percent of the constant; not_expected: why none can be."""
NOTHING = 1.0
"""A constant known to its own size is not told."""
LEAST = 1e-6


def expected(recording: Recording, runs: Sequence[Run], asked_vehicle: str | None) -> Row:
    """The columns of a recording. runs: its flights, without gaps. Never raises for what it holds:
    that is ``not_expected``."""
    from groundstation.dynamics.vehicle import load_vehicle
    from groundstation.identification.excitation import flight_excitation
    from groundstation.identification.stretches import stretches_of
    from groundstation.recording.craft_family import vehicle_of

    try:
        vehicle = load_vehicle(vehicle_of([recording], asked_vehicle) or "crazyflie1")
        shares = flight_excitation(stretches_of(runs, vehicle.motor), vehicle)
    except BadInputError as error:
        return {"not_expected": str(error)}
    except Exception as error:  # the recording is none the worse for a fault of ours
        return {"not_expected": f"{type(error).__name__}: {error}"}
    return {PERCENT[name]: 100.0 * share for name, share in shares.items() if math.isfinite(share)}


def errors_of(rows: Sequence[Row], fits: Mapping[str, Row]) -> dict[str, tuple[float, ...]]:
    """Address -> relative standard errors of ``AXES``, of the recordings of one craft: its fits' if
    all were fitted, otherwise the expected ones of all, so that they can be compared."""
    if all(row["address"] in fits for row in rows):
        return {row["address"]: _fitted(fits[row["address"]]) for row in rows}
    return {row["address"]: tuple(_expected(row, name) for name in AXES) for row in rows}


@dataclass(frozen=True, slots=True)
class Expectation:
    """What a craft's flights may be expected to tell together. flights: that are usable; worth:
    of them, those that alone tell c0 and c1 well enough for a design; errors: constant -> relative
    standard error, ``NOTHING`` where none shows it."""

    flights: int
    worth: int
    errors: dict[str, float]


def expectations(rows: Iterable[Row]) -> dict[str, Expectation]:
    """Craft -> what its usable flights may be expected to tell."""
    from groundstation.control.uncertainty import MOST_STDERR

    by_craft: dict[str, list[Row]] = {}
    for row in rows:
        by_craft.setdefault(row["craft"], []).append(row)
    return {craft: _together(flights, MOST_STDERR) for craft, flights in sorted(by_craft.items())}


def _together(flights: Sequence[Row], most: Mapping[str, float]) -> Expectation:
    errors = {}
    for name in TOLD:
        known = [_expected(row, name) for row in flights if row[PERCENT[name]] is not None]
        errors[name] = _bounded(sum(one**-2 for one in known) ** -0.5) if known else NOTHING
    worth = sum(all(_expected(row, name) <= most[name] for name in AXES[:2]) for row in flights)
    return Expectation(len(flights), worth, errors)


def _expected(row: Row, name: str) -> float:
    percent = row[PERCENT[name]]
    return NOTHING if percent is None else _bounded(0.01 * percent)


def _bounded(share: float) -> float:
    return min(NOTHING, max(share, LEAST))


def _fitted(fit: Row) -> tuple[float, ...]:
    values = ((fit[name], fit[f"{name}_stderr"]) for name in AXES)
    return tuple(
        NOTHING if value is None or stderr is None else _bounded(stderr / abs(value))
        for value, stderr in values
    )
