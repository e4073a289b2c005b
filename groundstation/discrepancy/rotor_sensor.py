"""The lag of the sensor behind recorded rotor speeds: its name, where the given model has none.

Wherever rows show speeds it is fitted along with the base constants, and so no candidate that
joins. In the end it is weighed as one that did: against the fit without it, through the same gates.
One that the model has stays as it was given (``Problem.base_keys``).
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
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.motion import ALONG, SENSOR_LAG
from groundstation.identification.likelihood.problem import Problem


def with_sensor_lag(outcome: Outcome, problem: Problem, folds: Sequence[Flight]) -> Outcome:
    """The outcome of a search in which the sensor's lag is one of the effects, or refused."""
    final = outcome.final
    if SENSOR_LAG not in final.keys:
        return outcome
    (evidence,) = gather(problem, folds, final, [ALONG])
    why = refusal(Stage.WEIGHED, Trial(ALONG, final, evidence=evidence))
    size, error = final.point[SENSOR_LAG], final.stderr()[SENSOR_LAG]
    scored = Scored(ALONG, evidence.drop, np.array([size]), np.array([error]))
    return replace(
        outcome,
        accepted=[*outcome.accepted, *([] if why else [Accepted(ALONG, evidence)])],
        refused={**outcome.refused, **({ALONG.label: why} if why else {})},
        held_out={**outcome.held_out, ALONG.label: evidence.held_out},
        scores=[*outcome.scores, scored],
    )
