"""Which propeller is out of balance: ``propeller_imbalance``.

No column shows it, for nobody knows the angle of a rotor: it is told by its power
(``vibration.py``), changes no prediction, and closes no gap, since vibration counts as noise. Every
propeller shakes a little; named is a rotor that shakes more than the three others together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from groundstation.discrepancy.acceptance import LEAST_DROP, Shaken, shaken_refusal
from groundstation.discrepancy.findings import Candidate, Findings, Refusal, with_last
from groundstation.discrepancy.vibration import (
    IMBALANCE,
    SIZES,
    Shaking,
    Windows,
    most_of,
    shaking_of,
    shares_of,
    windows_of,
)
from groundstation.dynamics.effect import FORCE, GYRO
from groundstation.dynamics.model import Estimate, Model, model_vehicle
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.motion import Point, spin_rotors
from groundstation.identification.likelihood.problem import ON_BOARD, Problem
from groundstation.telemetry.arrays import Array


def with_imbalance(findings: Findings, problem: Problem, point: Point) -> Findings:
    """The findings, with ``propeller_imbalance`` as the last effect where one rotor shakes the
    craft. point: where the search ended, which says how fast rotors turned."""
    if any(term.name == IMBALANCE.name for term in findings.model.effects):
        return findings
    fitted = _windows(problem.flights, problem, point, findings.base)
    if not fitted:
        return findings
    asked = shaken_most(fitted)
    why = shaken_refusal(asked)
    found = replace(findings, candidates=(*findings.candidates, _candidate(asked, why)))
    return found if why else _joined(found, asked)


def shaken_most(fitted: Sequence[Windows]) -> Shaken:
    """The rotor that surely shakes the craft most, and what its gates are asked of."""
    shares = shares_of(fitted, LEAST_DROP)
    shaking = shaking_of(fitted, shares)
    kind, rotor = max(np.ndindex(len(SIZES), 4), key=lambda at: shaking.t(*at))
    alone = 0.0
    if shaking.t(kind, rotor) > 0.0:
        alone = shaking.over_others(kind, rotor, most_of(fitted, shares))
    square = float(shaking.squares[kind, rotor])
    slope, curvature = shaking.beside_others(kind, rotor)
    sizes = (shaking_of([one], shares).size(kind, rotor) for one in fitted)
    return Shaken(
        effect=IMBALANCE,
        parameters=_parameters(shaking, rotor),
        t=shaking.t(kind, rotor),
        drop=slope**2 / curvature if curvature > 0.0 else 0.0,
        alone=alone,
        recordings=_apart(np.array(list(sizes)), math.sqrt(square)),
        channels=tuple(np.flatnonzero(fitted[0].per_size[0, :, :, rotor].any(axis=0)).tolist()),
    )


def _windows(
    flights: Sequence[Flight], problem: Problem, point: Point, model: Model
) -> list[Windows]:
    frame = problem.frame
    craft, corners = frame.craft(point), _corners_hz(model)
    found = (windows_of(one, spin_rotors(one, point, frame).end, craft, corners) for one in flights)
    return [one for one in found if one is not None]


def _corners_hz(model: Model) -> tuple[float, float]:
    """Of the filters behind gyro and accelerometer: the model's, or else the vehicle's."""
    given = {term.name: term for term in model.effects}
    corners = []
    for channels in (GYRO, FORCE):
        (effect,) = (one for one in ON_BOARD.values() if one.channels == channels)
        (size,) = effect.sizes
        if effect.name in given:
            corners.append(given[effect.name].parameters[size.name].value)
        else:
            corners.append(float(getattr(model_vehicle(model), effect.on_board)))
    gyro, force = corners
    return gyro, force


def _parameters(shaking: Shaking, rotor: int) -> dict[str, Estimate]:
    found = {"rotor": Estimate(rotor + 1.0)}
    for kind, one in enumerate(IMBALANCE.sizes):
        found[one.name] = Estimate(*shaking.size(kind, rotor), one.unit)
    return found


def _apart(sizes: Array, whole: float) -> tuple[float, float]:
    """Standard errors, and share of the whole, by which one flight's size (n, 2), with its error,
    is away from all flights'."""
    away = np.abs(sizes[:, 0] - whole)
    worst = int(np.argmax(away / sizes[:, 1]))
    return float(away[worst] / sizes[worst, 1]), float(away[worst] / max(whole, 1e-300))


def _candidate(asked: Shaken, why: Refusal | None) -> Candidate:
    return Candidate(
        IMBALANCE.name,
        dict(asked.parameters),
        asked.drop,
        asked.t,
        0.0,
        why is None,
        why,
    )


def _joined(findings: Findings, asked: Shaken) -> Findings:
    evidence = {
        "likelihood_ratio": asked.drop,
        "t": asked.t,
        "over_others": asked.alone,
    }
    return with_last(findings, IMBALANCE, asked.parameters, evidence, asked.channels)
