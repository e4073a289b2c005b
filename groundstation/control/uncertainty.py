"""What the fit is unsure of, as other models that could be the true one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from groundstation.dynamics.meanings import DEAD_TIME, MOST_DELAY_S, MOST_STDERR, WORDS, suitability
from groundstation.dynamics.model import BodyConstants, Estimate, Model, with_motor
from groundstation.dynamics.registry import DELAY
from groundstation.dynamics.vehicle import MotorConstants
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array

BODY = ("c0", "c1", "c2", "thrust_per_mass")
MOTOR = ("a0", "a1", "a2")
CORNER = 2.0
"""Standard errors to either side that a design must bear."""
LEAST_CORNER = 0.05
RECORD = {
    "c0": "roll doublets of +-8 deg or more, 30 s of them",
    "c1": "pitch doublets of +-8 deg or more, 30 s of them",
    "c2": "yaw rate doublets of +-90 deg/s or more, 60 s of them, fitted with"
    " the effects that 'fit body' says the data show",
    DELAY: f"fast roll and pitch doublets, 30 s of them, fitted with --with {DEAD_TIME}",
}


def estimates_of(model: Model) -> list[tuple[tuple[str, ...], Array, Array]]:
    """What the model's fits estimated: (names, values (p,), covariance (p, p)) of each fit.

    Names are those of ``BODY``, ``MOTOR`` and ``effect.parameter``.
    """
    found = []
    for stage in ("motor", "body"):
        account: dict[str, Any] = model.fit.get(stage, {}).get("estimates", {})
        names = tuple(account.get("names", ()))
        covariance = np.array(account.get("covariance", ()), np.float64)
        if names and covariance.shape == (len(names), len(names)):
            found.append((names, np.array(account["values"], np.float64), covariance))
    return found


def standard_errors(model: Model) -> dict[str, tuple[float, float]]:
    """Parameter -> (value, standard error), of everything that the model's fits estimated."""
    return {
        name: (float(value), float(math.sqrt(max(variance, 0.0))))
        for names, values, covariance in estimates_of(model)
        for name, value, variance in zip(names, values, np.diag(covariance), strict=True)
    }


def require_certain(model: Model, axes: Sequence[str]) -> None:
    """Raises BadInputError for axes of a model that no gains are designed on
    (``dynamics.suitability``): why, and what to record."""
    found = suitability(model)
    refused = [axis for axis in axes if axis in found and not found[axis].designs]
    if not refused:
        return
    told = model.fit["body"].get("record", {})
    why, record = [], []
    for axis in refused:
        one = found[axis]
        why.append(f"{axis}: the model is {WORDS[one.use]} ({one.key}: {one.reasons[0]})")
        record.append(told.get(one.key, RECORD[one.key]))
    others = [f"--axis {axis}" for axis in axes if axis not in refused]
    raise BadInputError(
        f"{'; '.join(why)}; a standard error of {100 * MOST_STDERR:.0f} %, of a delay"
        f" {1e3 * MOST_DELAY_S:g} ms, is the most for a design; record"
        f" {', and '.join(dict.fromkeys(record))}, and fit again"
        + (f"; the rest can be designed: {' '.join(others)}" if others else "")
    )


def draws(model: Model, count: int, seed: int = 0) -> list[Model]:
    """Models drawn from the fits' covariances, each of which could be the true one.

    Raises BadInputError where the model carries no covariance.
    """
    parts = estimates_of(model)
    if not parts:
        raise BadInputError(
            f"model for {model.vehicle}: it carries no covariance, so nothing can be said about"
            " its uncertainty; fit it from a recording ('groundstation fit body')"
        )
    generator = np.random.default_rng(seed)
    moves = []
    for names, _, covariance in parts:
        roots, vectors = np.linalg.eigh(covariance)
        scale = vectors * np.sqrt(np.maximum(roots, 0.0))
        moves.append((names, generator.standard_normal((count, len(names))) @ scale.T))
    return [
        moved(
            model,
            {
                name: float(difference)
                for names, table in moves
                for name, difference in zip(names, table[index], strict=True)
            },
        )
        for index in range(count)
    ]


def corners(model: Model, axis: str) -> list[Model]:
    """The model itself and two others, two standard errors away for the worse: a loop gain that
    is higher with a longer delay, and one that is lower with a longer delay.

    A loop gain is taken for uncertain by 5 % at least: a battery moves it by more in a flight.
    """
    known = standard_errors(model)
    name = BODY[AXES.index(axis)]
    nominal = getattr(model.body, name)
    _, gain = known.get(name, (0.0, 0.0))
    _, late = known.get(DELAY, (0.0, 0.0))
    gain = max(CORNER * gain, LEAST_CORNER * nominal)
    return [
        model,
        *(moved(model, {name: sign * gain, DELAY: CORNER * late}) for sign in (1.0, -1.0)),
    ]


def moved(model: Model, differences: dict[str, float]) -> Model:
    """The model with parameters changed by differences; what must be positive stays so."""
    motor = {n: getattr(model.motor, n) + differences.get(n, 0.0) for n in MOTOR}
    motor["a0"], motor["a1"] = _positive(motor["a0"]), _positive(motor["a1"])
    body = model.body
    if body is not None:
        constants = {n: _positive(getattr(body, n) + differences.get(n, 0.0)) for n in BODY}
        body = BodyConstants(**constants)
    effects = []
    for term in model.effects:
        parameters = {}
        for name, estimate in term.parameters.items():
            value = estimate.value + differences.get(f"{term.name}.{name}", 0.0)
            if term.name == DEAD_TIME:
                value = max(value, 0.0)
            parameters[name] = Estimate(value, estimate.stderr, estimate.unit)
        effects.append(msgspec.structs.replace(term, parameters=parameters))
    return msgspec.structs.replace(
        with_motor(model, MotorConstants(**motor)), body=body, effects=tuple(effects)
    )


def _positive(value: float) -> float:
    return max(value, 1e-12)
