"""Is this estimate a result? One set of rules for every fit, whatever it fitted.

An estimate that stands where it began, one that no error is known of, one that no craft of the
profile can have, and a model that predicts what it has not seen worse than the mean does, are what
a fit leaves that could not fit: they are never passed on as a result.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from groundstation.dynamics.meanings import is_unusual, profile_constants
from groundstation.dynamics.model import Model
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError

UNLIKE = 5.0
"""Times the profile's value, or one over it, that no craft of the profile has; one beyond
``suitability.UNUSUAL`` is worth a word."""
FREE = ("c2", "a1", "a2")
"""Constants that differ more from craft to craft, with the propellers and what drags on them: they
are worth a word where others are none, and the rest of the model stands."""
USELESS = -100.0
"""Per cent of fit, errors of twice the mean's, from which a model is none."""
TILT = ("roll", "pitch")
AWAY = 1e-9
"""Relative distance from its start by which an estimate has moved."""


def require_results(
    account: Mapping[str, Any], before: Model, vehicle: Vehicle, of_recordings: Sequence[str] = ()
) -> list[str]:
    """What is doubtful of a fit, in words.

    of_recordings: what is wrong with what it was made on, as far as that is known.

    Raises BadInputError, with the reasons, where estimates of it are no results.
    """
    reasons, doubts = no_results(account, before, vehicle)
    if reasons:
        raise BadInputError(
            f"{account['what']} not identified, because {'; '.join(reasons)}"
            + (f" ({'; '.join(of_recordings)})" if of_recordings else "")
            + ": look at the recordings with 'groundstation inspect', and is --vehicle the craft?"
        )
    return doubts


def no_results(
    account: Mapping[str, Any], before: Model, vehicle: Vehicle
) -> tuple[list[str], list[str]]:
    """Why estimates of a fit are none, and what is doubtful of those that are, in words.

    account: what a workflow says of its fit. before: the model it began with.
    """
    reasons: list[str] = []
    doubts: list[str] = []
    for name, value, error in _estimates(account):
        told = account.get("not_identified", {})
        if name in told:
            continue
        start, usual = _starts(before, vehicle).get(name), profile_constants(vehicle).get(name)
        if not np.isfinite(value) or not np.isfinite(error):
            reasons.append(f"{name} is {value:.3g} +- {error:.2g}")
        elif error == 0.0:
            at = " where it began" if start is not None and _is_at(value, start) else ""
            reasons.append(f"{name} stands at {value:.4g}{at} and nothing tells its error")
        elif start is not None and _is_at(value, start):
            reasons.append(f"{name} did not move from where it began, {value:.4g}")
        elif usual and is_unusual(value, usual, UNLIKE):
            line = f"{name} is {value:.3g}, and {usual:.3g} by the profile {vehicle.name!r}"
            (doubts if name in FREE else reasons).append(line)
        elif usual and is_unusual(value, usual):
            doubts.append(f"{name} is {value:.3g}, and {usual:.3g} by the profile {vehicle.name!r}")
    for name, percent, decides in _fits(account.get("validation")):
        if percent < 0.0:
            line = (
                f"{name} on unseen data is predicted worse than by its mean (fit {percent:.0f} %)"
            )
            (reasons if decides and percent < USELESS else doubts).append(line)
    return reasons, doubts


def _estimates(account: Mapping[str, Any]) -> Iterator[tuple[str, float, float]]:
    found = account.get("estimates") or {}
    columns: Sequence[Sequence[Any]] = [found.get(key, ()) for key in ("names", "values", "stderr")]
    for name, value, error in zip(*columns, strict=True):
        if "." not in name:  # of an effect: its own range is judged by who fits it
            yield str(name), float(value), float(error)


def _fits(validation: Any) -> Iterator[tuple[str, float, bool]]:
    """Name and per cent of what was predicted of unseen data, and whether it decides.

    Of a body roll and pitch do, where neither is predicted better than by its mean: a flight may
    hardly turn about one axis, or hardly climb, and then its mean is a better prediction than any
    model's that misses an effect.
    """
    if isinstance(validation, Mapping):
        percents = {k: float(v) for k, v in validation.items() if "fit_percent" in k}
        for name, percent in percents.items():
            both = (name.replace("roll", "pitch"), name.replace("pitch", "roll"))
            decides = any(one in name for one in TILT) and all(percents[one] < 0.0 for one in both)
            yield name.replace("_fit_percent", "").replace("_", " "), percent, decides
    elif isinstance(validation, Sequence):
        yield from (
            (f"rotor speed of {one['recording']}", float(one["rotor_fit_percent"]), True)
            for one in validation
            if "rotor_fit_percent" in one
        )


def _is_at(value: float, start: float) -> bool:
    return abs(value - start) <= AWAY * abs(start)


def _starts(before: Model, vehicle: Vehicle) -> dict[str, float]:
    """Where a fit began: the model's constants, or else the profile's."""
    found = profile_constants(vehicle)
    motor, body = before.motor, before.body
    found |= {"a0": motor.a0, "a1": motor.a1, "a2": motor.a2}
    if body is not None:
        found |= {
            **{"c0": body.c0, "c1": body.c1, "c2": body.c2},
            "thrust_per_mass": body.thrust_per_mass,
        }
    return found
