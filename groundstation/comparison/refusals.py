"""Recordings that a model cannot be held against, refused in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from groundstation.comparison.gap import GYRO, AheadErrors
from groundstation.errors import BadInputError
from groundstation.identification.runs import Run

LEAST_FLIGHT_S = 3.0
NEEDED = {"gyro": "the gyro", "duty": "the motors' PWM", "supply_v": "the battery voltage"}
"""Channels that nothing works without."""


def missing_channel(run: Run) -> str | None:
    """In words, the first of ``NEEDED`` that is missing throughout."""
    for name, what in NEEDED.items():
        if not np.isfinite(getattr(run, name)).any(axis=0).all():
            return what
    return None


def require_channels(runs: Sequence[Run]) -> None:
    """Raises BadInputError where a channel that nothing works without is missing throughout."""
    for run in runs:
        what = missing_channel(run)
        if what is not None:
            raise BadInputError(
                f"{run.name}: {what} is not in the recording; where a model and a flight"
                " disagree cannot be told without it: record it"
            )


def require_flight(errors: Sequence[AheadErrors]) -> None:
    """Raises BadInputError where hardly anything flies."""
    flown = sum(float(one.motion.flown.sum()) * one.run.period_s for one in errors)
    if flown < LEAST_FLIGHT_S:
        names = ", ".join(sorted({one.run.name for one in errors}))
        raise BadInputError(
            f"{names}: {flown:.1f} s in the air, at least {LEAST_FLIGHT_S:.0f} s are needed;"
            " record a flight"
        )


def require_predictions(errors: Sequence[AheadErrors]) -> None:
    """Raises BadInputError where a model predicts no number of a rate in any row."""
    known = sum(np.isfinite(one.step[:, GYRO]).sum(axis=0) for one in errors)
    if not np.all(known):
        names = ", ".join(sorted({one.run.name for one in errors}))
        raise BadInputError(
            f"{names}: the model predicts no number there: something in it grows without end;"
            " look at its motor constants and at effects of your own first"
        )
