"""From recordings to the runs that motors are fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from groundstation.errors import BadInputError
from groundstation.identification.recordings import bridged
from groundstation.identification.runs import Run, runs_of
from groundstation.telemetry.samples import SampleBatch

LONG_S, MOST = 2.5, 0.8
"""Stretches from which a motor fit gains, and the share of a recording that they hold at least."""


def motor_runs(recordings: Sequence[tuple[SampleBatch, str]]) -> list[Run]:
    """Runs of the motor bench as they are. Flights with recorded rotor speeds uncut where long
    stretches hold most of them, else bridged: what a motor was given in a lost row may be far from
    a straight line.

    recordings: the samples of each, and its name.

    Raises BadInputError where a recording has no run, or a rate that is not one of inertial
    telemetry.
    """
    if not any(np.isfinite(samples.rotor_rev_s).any() for samples, _ in recordings):
        return [run for samples, name in recordings for run in runs_of(samples, name)]
    return [run for samples, name in recordings for run in _flown(samples, name)]


def _flown(samples: SampleBatch, name: str) -> list[Run]:
    try:
        long = runs_of(samples, name, LONG_S)
    except BadInputError:
        long = []
    whole = sum(map(len, long)) >= MOST * len(samples)
    return long if whole else bridged(samples, name, least_s=1.0)
