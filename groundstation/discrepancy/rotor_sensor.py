"""The lag of the sensor behind recorded rotor speeds: its name, where the given model has none.

Wherever rows show speeds it is fitted along with the base constants, and so no candidate that
joins. In the end it is weighed as one that did: against the fit without it, through the same gates.
One that the model has stays as it was given: a search that holds no delay takes up in the lag,
which acts the other way, what there is of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from groundstation.discrepancy.acceptance import Stage, Trial, refusal
from groundstation.discrepancy.evidence import gather
from groundstation.discrepancy.screening import Scored
from groundstation.discrepancy.search import Outcome
from groundstation.discrepancy.search_state import Accepted
from groundstation.dynamics.model import Estimate, Model
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.parameters import ALONG, SENSOR_LAG, absent
from groundstation.identification.likelihood.problem import Problem


def with_sensor_lag(
    outcome: Outcome, problem: Problem, held: Sequence[Flight], model: Model
) -> Outcome:
    """The outcome of a search in which the sensor's lag is one of the effects, or refused. model:
    as it was given."""
    final = outcome.final
    if _given(model) is not None or SENSOR_LAG not in final.keys:
        return outcome
    without = {**final.point, SENSOR_LAG: absent(SENSOR_LAG)}
    before = problem.fit(without, [key for key in final.keys if key != SENSOR_LAG])
    evidence = gather(problem, held, before, final, ALONG)
    why = refusal(Stage.WEIGHED, Trial(ALONG, final, evidence=evidence))
    size, error = final.point[SENSOR_LAG], final.stderr()[SENSOR_LAG]
    scored = Scored(ALONG, evidence.drop, np.array([size]), np.array([error]))
    return replace(
        outcome,
        accepted=[*outcome.accepted, *([] if why else [Accepted(ALONG, evidence, [])])],
        refused={**outcome.refused, **({ALONG.label: why} if why else {})},
        held_out={**outcome.held_out, ALONG.label: evidence.held_out},
        scores=[*outcome.scores, scored],
    )


def as_given(outcome: Outcome, model: Model) -> Outcome:
    """The outcome with the lag, and its error, that the given model has, if it has one."""
    lag = _given(model)
    if lag is None:
        return outcome
    final = replace(outcome.final, point={**outcome.final.point, SENSOR_LAG: lag.value})
    errors = {key: error for key, error in outcome.errors.items() if key != SENSOR_LAG}
    if lag.stderr is not None:
        errors[SENSOR_LAG] = lag.stderr
    return replace(outcome, final=final, errors=errors)


def _given(model: Model) -> Estimate | None:
    (size,) = ALONG.definition.sizes
    found = (term.parameters[size.name] for term in model.effects if term.name == ALONG.effect)
    return next(found, None)
