"""How a search judges what it found by predictions.

What drifts slowly is in every prediction and belongs to no effect of a search: beside it one that
is right may seem to predict worse. So it is followed where effects are weighed. Whether it has a
name is asked of the final model (``slow_disturbance``), and so is whether that predicts worse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from groundstation.discrepancy.acceptance import Stage, lasting_refusal
from groundstation.discrepancy.findings import Predicted
from groundstation.discrepancy.proof import HeldOut, Predictions
from groundstation.discrepancy.slow_disturbance import (
    Slow,
    best_followed,
    has_wind,
    slow_part,
    with_term,
)
from groundstation.dynamics.model import Model
from groundstation.identification.likelihood.parameters import Point


class Judge:
    """Held-out rows as the model at a point predicts them, beside what the given model says.

    ``follow`` lets the observer follow what is slow from then on, in the given model and in all
    others alike.
    """

    def __init__(
        self, held: HeldOut, model_at: Callable[[Point], Model], train: Predictions | None
    ) -> None:
        """train: the given model on the rows that were fitted, None: nothing is ever followed."""
        self._given, self._model_at, self._train = held, model_at, train
        self._held = held
        self._slow: Slow | None = None

    def __call__(self, point: Point) -> Predicted:
        model = self._model_at(point)
        if self._slow is None:
            return self._given.judge(model)
        found = self._held.judge(with_term(model, self._slow))
        if not found.worse:
            return found
        # A channel that is predicted better where nothing is followed is no witness.
        better = self._given.of(model).rms < self._given.before.rms
        worse = {c: t for c, t in found.worse.items() if not better[c]}
        return replace(found, worse=worse)

    def raises_plainly(self, before: Point, after: Point) -> bool:
        """Whether the gap of one point is above another's where nothing is followed."""
        low, high = (self._given.judge(self._model_at(point)).gap for point in (before, after))
        return high > low

    @property
    def follows(self) -> bool:
        """Whether anything is followed."""
        return self._slow is not None

    def follow(self, point: Point) -> None:
        """What the model at a point leaves that lasts, if anything does."""
        base = self._model_at(point)
        if self._train is None or has_wind(base):
            return
        fitted = self._train.of(base)
        slow = slow_part(fitted.errors)
        if lasting_refusal(Stage.WEIGHED, slow.asked()):
            self._held, self._slow = self._given, None
            return
        self._slow = best_followed(slow, fitted)
        self._held = HeldOut(self._given.of(with_term(self._given.before.model, self._slow)))
