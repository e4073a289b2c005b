"""A search is made once more with the constants of rotation as given, where they went far.

In closed loop there is more than one best fit: a craft of half the gains beside a sensor that is
turned explains real flights one row ahead as well as the craft that was given beside other effects
does, and which of the two a search comes to may hang on its first step. Predictions tell: on
NanoBench's circle they were five times worse.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

from groundstation.discrepancy.findings import Findings
from groundstation.discrepancy.prediction_gate import lower
from groundstation.discrepancy.proof import FittedRows
from groundstation.identification.likelihood.parameters import BODY_KEYS

ROTATION = BODY_KEYS[:3]
FAR = 0.2
"""Logarithm of a change from which c0, c1, c2 are held for comparison: flights of one craft tell
them to less than that where they tell them at all."""


def or_with_given_constants(
    found: Callable[[Collection[str]], Findings],
    held: FittedRows | None,
    progress: Callable[[str, float], None],
) -> Findings:
    """What is found where everything is free, or with ``ROTATION`` as given where these went far
    and fitted samples are predicted clearly better so.

    found: a search with constants that stay. held: the given model on fitted samples; None: they
    are not asked, and everything is free.
    """
    free = found(())
    if held is None or not any(
        one.name in ROTATION and abs(math.log(one.value / one.given)) > FAR
        for one in free.base_changes
    ):
        return free
    progress("searching once more with c0, c1 and c2 as given", -1.0)
    return better(free, found(ROTATION), held)


def better(free: Findings, steady: Findings, held: FittedRows) -> Findings:
    """``steady`` where it predicts fitted samples clearly better, no channel worse; or ``free``."""
    one, other = (held.judge(each.model) for each in (free, steady))
    return steady if other.badness[0] <= one.badness[0] and lower(other, one) else free
