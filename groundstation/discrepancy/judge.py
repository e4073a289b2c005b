"""How a search judges what it found by predictions.

What drifts slowly is in every prediction and belongs to no effect of a search: beside it one that
is right may seem to predict worse. So it is followed where effects are weighed. Whether it has a
name is asked of the final model (``slow_disturbance``), and so is whether that predicts worse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from groundstation.comparison.comparison import Comparison
from groundstation.discrepancy.findings import Predicted
from groundstation.discrepancy.proof import LEFT, FittedRows
from groundstation.discrepancy.screening import without
from groundstation.discrepancy.search_state import Accepted
from groundstation.discrepancy.slow_disturbance import (
    Slow,
    best_followed,
    is_followed,
    slow_part,
    with_term,
)
from groundstation.discrepancy.weight import Weight, weight
from groundstation.dynamics.model import Model
from groundstation.identification.likelihood.motion import Point

CLEARLY_T = 2.0
"""Standard errors by which a channel is worse beside what is followed. There one is no reason: how
much of a channel the follower takes depends on the model a little, and that the given model as it
is predicts nothing better is asked of the final one."""


class Judge:
    """Fitted rows as the model at a point predicts them, beside what the given model says; the
    observer follows what is ``slow`` in both alike, where it is given."""

    def __init__(
        self, fitted: FittedRows, model_at: Callable[[Point], Model], slow: Slow | None = None
    ) -> None:
        self._given, self._model_at, self._slow = fitted, model_at, slow
        given = fitted.before.model
        self._beside = FittedRows(fitted.of(with_term(given, slow))) if slow else fitted

    def __call__(self, point: Point) -> Predicted:
        model = self._model_at(point)
        if self._slow is None:
            return self._given.judge(model)
        found = self._beside.judge(with_term(model, self._slow))
        if not found.worse:
            return found
        # A channel that is predicted better where nothing is followed is no witness, nor is one
        # within noise that hardly changes.
        better = self._given.of(model).rms < self._given.before.rms
        before = self._beside.before
        hardly = LEFT * before.rms / before.noise_floor
        worse = {
            channel: t
            for channel, t in found.worse.items()
            if t >= CLEARLY_T
            and not better[channel]
            and not found.gaps[channel] <= min(1.0, hardly[channel])
        }
        return replace(found, worse=worse)

    def weights(self, point: Point, accepted: Sequence[Accepted]) -> dict[str, Weight]:
        """What each of these effects carries, by label; none of those that touch only channels in
        which nothing is left to explain."""
        improved, found = self._model(point), {}
        near = self._beside.of(improved)
        now = self._beside.squares(improved)
        for one in accepted:
            left = self._beside.squares(self._model(without(point, one.variant)), near)
            carried = weight(self._given.before.gap, now, left, one.evidence.channels)
            if carried is not None:
                found[one.variant.label] = carried
        return found

    def _model(self, point: Point) -> Model:
        """With what is slow."""
        model = self._model_at(point)
        return model if self._slow is None else with_term(model, self._slow)


def to_follow(fitted: Comparison) -> Slow | None:
    """What a model leaves of fitted rows that lasts, as predictions are best; None: nothing does,
    or the model says of itself what is slow."""
    if is_followed(fitted.model):
        return None
    slow = slow_part(fitted.errors)
    return best_followed(slow, fitted) if slow.is_there else None
