"""Gains for the model that was found, and what steps that were flown say of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from groundstation.control.design import RMS, Budget, cascade_limits, closest_cascade
from groundstation.control.programme import Programme
from groundstation.control.step_analysis import Flown, FlownAxis, analyse_recording
from groundstation.dynamics.model import Model
from groundstation.errors import BadInputError
from groundstation.learn.journal import Landed
from groundstation.learn.manoeuvres import Limits
from groundstation.recording.formats import open_for_analysis
from groundstation.telemetry.arrays import AXES

CLIENT = "learn"
OVERSHOOT_MORE = 5.0
"""Points of a step by which an axis may overshoot more than with the gains before."""
BUDGET = Budget(first=120, population=16, generations=20)
ANGLE_DEG, HOLD_S, REPEATS = 10.0, 0.7, 2
BEFORE, AFTER = "steps_before.mcap", "steps_after{}.mcap"
"""Flights of steps: with the gains before, and with new ones, numbered from 1."""


class StepFlight(Programme):
    """Doublets of every axis, with what the journal wants to know."""

    purpose = "doublets, to see how the gains follow"

    @property
    def seconds(self) -> float:
        return self.held_seconds

    def timeline(self) -> list[dict[str, Any]]:
        fly = f"{self.repeats} doublets an axis"
        return [{"at_s": 0.0, "seconds": self.seconds, "fly": fly}]


def step_flight(limits: Limits) -> StepFlight:
    """The same for all gains of a craft."""
    return StepFlight(angle_deg=limits.lean(ANGLE_DEG, HOLD_S), hold_s=HOLD_S, repeats=REPEATS)


def designed_gains(model: Model) -> dict[str, float]:
    """Of each axis the gains that follow a step the closest within the limits of ``pid design``.

    An axis keeps its stock gains where by the model they follow as closely. Raises BadInputError
    where every axis does.
    """
    found: dict[str, float] = {}
    faults = []
    for axis in AXES:
        try:
            gains, judged, stock = closest_cascade(model, axis, cascade_limits(), budget=BUDGET)
        except BadInputError as error:
            faults.append(str(error))
            continue
        found |= gains if judged[RMS] < stock[RMS] else {}
    if not found:
        raise BadInputError(
            "; ".join(faults) or "by the model the stock gains follow steps best on every axis"
        )
    return found


def flown_steps(folder: Path, flight: Landed, model: Model) -> Flown:
    """The doublets of a flight, measured, and as a model predicts them."""
    return analyse_recording(open_for_analysis(folder / flight.file), model, flight.gains, CLIENT)


def missed(axis: FlownAxis) -> float:
    """RMS of an axis's steps as a share of their size."""
    return axis.measured.rms / axis.step


def mean_missed(flown: Flown) -> float:
    """The same, mean of the axes."""
    return float(np.mean([missed(one) for one in flown.axes]))


def of_better_axes(gains: dict[str, float], before: Flown, after: Flown) -> dict[str, float]:
    """The gains of those axes that followed their steps more closely with them, and overshot them
    by no more than ``OVERSHOOT_MORE`` points more."""
    axes = zip(before.axes, after.axes, strict=True)
    better = {
        new.axis
        for old, new in axes
        if missed(new) < missed(old) and overshoots_more(old, new) <= OVERSHOOT_MORE
    }
    return {name: value for name, value in gains.items() if axis_of(name) in better}


def overshoots_more(before: FlownAxis, after: FlownAxis) -> float:
    """By how many points of the step."""
    return after.measured.overshoot_pct - before.measured.overshoot_pct


def told_overshoots(before: Flown, after: Flown) -> str:
    """Of every axis before and after, in words, with what the model predicted."""
    parts = []
    for old, new in zip(before.axes, after.axes, strict=True):
        says = "" if new.predicted is None else f" ({new.predicted.overshoot_pct:.0f} predicted)"
        parts.append(
            f"{new.axis} {old.measured.overshoot_pct:.0f} to {new.measured.overshoot_pct:.0f}{says}"
        )
    return f"overshoot in %: {', '.join(parts)}"


def axis_of(gain: str) -> str:
    """Of a parameter's name: 'roll' of 'pid_rate.roll_kp'."""
    return gain.partition(".")[2].partition("_")[0]
