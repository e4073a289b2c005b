"""The live twin: samples in, what to show and what to tell out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.dynamics.model import Model, require_body
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.telemetry.samples import SampleBatch, empty_samples
from groundstation.twin.alarm import Episode, Judge
from groundstation.twin.rolling import Block, Rolling
from groundstation.twin.signals import allowances

QUIET = 0.35
"""Quantile of the blocks' variances that counts as noise: a disagreement shows in some blocks
more than in others."""
NOISE_BLOCKS, LEAST_BLOCKS = 60, 6

_CHANNELS = {
    "gyro_x": "roll rate",
    "gyro_y": "pitch rate",
    "gyro_z": "yaw rate",
    "accelerometer_x": "forward force",
    "accelerometer_y": "sideways force",
    "accelerometer_z": "vertical force",
    "roll": "roll angle",
    "pitch": "pitch angle",
    "yaw": "yaw angle",
}
_REGIMES = {
    "whole flight": "throughout",
    "roll or pitch torque": "after roll or pitch torque",
    "after yaw commands": "after yaw commands",
    "high roll or pitch rate": "at high roll or pitch rate",
    "high yaw rate": "at high yaw rate",
    "turning about several axes": "turning about several axes",
    "rotor acceleration": "after rotor acceleration",
    "rotors slowing down": "when rotors slow down",
    "translation": "in translation",
    "high thrust": "with thrust",
    "climb": "in climb and descent",
    "thrust change": "after thrust changes",
    "near ground": "near the ground",
    "tilted": "when tilted",
}


@dataclass(frozen=True, slots=True)
class Shown:
    """Half a second for the eye.

    segment, time_s: (m,) of the device. measured, predicted: (m, 9) SI, in the order of
    ``discrepancy.findings.CHANNELS``, the latter from 50 ms before. gap: (9,) prediction error
    20 and 50 ms ahead over what the noise of quiet stretches leaves; NaN where it was not judged.
    """

    segment: int
    time_s: Array
    measured: Array
    predicted: Array
    gap: Array


class Twin:
    """A model that flies beside a stream of samples, cut in any way.

    Raises BadInputError for a model without a body.
    """

    def __init__(self, model: Model) -> None:
        require_body(model)
        self._rolling = Rolling(model)
        self._judge = Judge(allowances(model, SAMPLE_PERIOD_S))
        self._steps: deque[Array] = deque(maxlen=NOISE_BLOCKS)

    def feed(self, samples: SampleBatch) -> Iterator[tuple[Shown, list[Episode]]]:
        """What each completed half second shows and tells.

        Raises BadInputError where samples lack what the model needs.
        """
        for block in self._rolling.feed(samples):
            told = self._judge.take(block)
            yield self._shown(block), told

    def interrupt(self, why: str) -> list[Episode]:
        """End what lasts: nothing after this belongs to it."""
        return self._judge.interrupt(why)

    def _shown(self, block: Block) -> Shown:
        if np.isfinite(block.step).all():
            self._steps.append(block.step)
        gap = np.full(9, np.nan)
        if len(self._steps) >= LEAST_BLOCKS and np.isfinite(block.error).all():
            quiet = np.quantile(np.stack(self._steps), QUIET, axis=0)
            gap = np.sqrt(block.error.sum(axis=0) / (block.leaves.sum(axis=0) @ quiet))
        return Shown(block.segment, block.time_s, block.measured, block.predicted, gap)

    @property
    def learnt(self) -> bool:
        """Whether the noise is known, so that disagreements can be told."""
        return self._judge.floor is not None

    @property
    def episodes(self) -> list[Episode]:
        """Disagreements that last."""
        return self._judge.episodes


def episodes_of(model: Model, pieces: Sequence[SampleBatch]) -> list[Episode]:
    """Fast time: what the twin would have told of a flight."""
    twin = Twin(model)
    return [told for piece in pieces for _, tell in twin.feed(piece) for told in tell]


def in_words(episode: Episode) -> str:
    """``yaw rate disagrees after rotor acceleration``, and how surely."""
    channel = _CHANNELS[episode.place.channel]
    regime = _REGIMES[episode.place.regime]
    if episode.end_s is None:
        return (
            f"{channel} disagrees {regime}: {episode.statistic:.1f} standard deviations"
            f" beyond the model since {episode.begin_s:.1f} s"
        )
    return f"{channel} no longer disagrees {regime}: {episode.why} ({episode.end_s:.1f} s)"


def warm_up(model: Model) -> None:
    """Compile, or load from the cache, what a twin runs: by half a second of made hover."""
    rows = round(2.0 / SAMPLE_PERIOD_S)
    made = empty_samples(rows, SAMPLE_PERIOD_S)
    made.ticks[:] = np.arange(rows)
    made.duty[:], made.battery_v[:] = 0.6, 3.8
    made.gyro[:], made.accelerometer[:], made.attitude[:] = 0.0, 9.8, 0.0
    for _ in Twin(model).feed(made):
        pass
