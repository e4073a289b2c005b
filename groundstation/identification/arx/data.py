"""One axis's input and output for ARX models, and whether they can tell anything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.vehicle import Configuration, MotorConstants, Motors
from groundstation.errors import BadInputError
from groundstation.identification.estimate import inverse
from groundstation.identification.runs import Run
from groundstation.identification.torque import rotor_squares
from groundstation.telemetry.arrays import AXES, Array

LEAST_ROWS = 300
SETTLE_S = 0.6
SHOWN_LAGS = 10


@dataclass(frozen=True, slots=True)
class ArxData:
    """One run of one axis. inputs: (n,) u' in (rev/s)^2, outputs: (n,) rad or rad/s."""

    name: str
    period_s: float
    inputs: Array
    outputs: Array


def arx_data(
    run: Run,
    axis: str,
    motor: MotorConstants | Motors,
    configuration: Configuration = "plus",
    *,
    channel: str = "attitude",
    decimate: int = 1,
) -> ArxData:
    """The mixer's u' and the angle (or the body rate) of one axis of a run.

    u' of a row is the mean over the period that ends with the row, so a body without delay has
    nk = 0 on its rate. The first 0.6 s are left out: motor speeds are uncertain there.

    channel: ``attitude`` (as in the thesis) or ``gyro``. decimate: keep every so many-th row. u'
    is averaged over the rows between, and so is the gyro (the same filter on both leaves the
    model what it is, and takes the rotors' vibration away); of the angle, which is fresh in every
    second row only, fresh rows are kept.

    Raises BadInputError where a channel is missing.
    """
    index = AXES.index(axis)
    outputs = getattr(run, channel)[:, index]
    if not np.isfinite(outputs).all():
        raise BadInputError(f"{run.name}: {channel} is not in every row; ARX on {axis} needs it")
    # The motors' simulation starts settled, which they were not: leave its transient out.
    settled = round(SETTLE_S / run.period_s)
    inputs = rotor_squares(run, motor).mixed(configuration)[settled:, index]
    outputs = outputs[settled:]
    if decimate > 1:
        first = _freshest(outputs, decimate) if channel == "attitude" else 0
        kept = np.arange(first + decimate, len(outputs), decimate)
        inputs = _block_means(inputs, kept, decimate)
        outputs = outputs[kept] if channel == "attitude" else _block_means(outputs, kept, decimate)
    columns = np.ascontiguousarray(inputs), np.ascontiguousarray(outputs)  # one type to numba
    return ArxData(run.name, run.period_s * decimate, *columns)


def _freshest(outputs: Array, decimate: int) -> int:
    """The row, of the first ``decimate``, from which every so many-th holds a fresh value."""
    changed = np.flatnonzero(np.diff(outputs)) + 1
    return int(np.bincount(changed % decimate, minlength=decimate).argmax())


def _block_means(values: Array, kept: NDArray[np.intp], decimate: int) -> Array:
    """Means over the rows that end with each kept one."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return (sums[kept + 1] - sums[kept + 1 - decimate]) / decimate


def input_shows(fit: Sequence[ArxData]) -> float:
    """How clearly the input shows in the output: F of 11 lagged inputs beside 10 past outputs.

    About 1 where it does not show at all; beyond 3 it certainly does.
    """
    longest = SHOWN_LAGS
    outputs, inputs = [], []
    targets = []
    for data in fit:
        rows = np.arange(longest, len(data.outputs))
        step = np.diff(data.outputs, prepend=data.outputs[0])
        targets.append(step[rows])
        outputs.append(np.column_stack([step[rows - i] for i in range(1, longest + 1)]))
        inputs.append(np.column_stack([data.inputs[rows - j] for j in range(longest + 1)]))
    target, past, driven = np.concatenate(targets), np.vstack(outputs), np.vstack(inputs)
    without = _left(np.column_stack([past, np.ones(len(past))]), target)
    both = np.column_stack([past, driven, np.ones(len(past))])
    left = _left(both, target)
    if left <= 0.0:
        return float("inf")
    return (without - left) / driven.shape[1] / (left / max(len(target) - both.shape[1], 1))


def _left(regressors: Array, target: Array) -> float:
    """Sum of squares that least squares leaves."""
    weights = inverse(regressors.T @ regressors) @ (regressors.T @ target)
    return float(np.square(target - regressors @ weights).sum())


def require_usable(data: ArxData, period_s: float, longest: int) -> None:
    """Raises BadInputError for data that no ARX model should see, with the reason."""
    if len(data.inputs) < LEAST_ROWS + longest:
        raise BadInputError(f"{data.name}: {len(data.inputs)} rows are too few for ARX models")
    if abs(data.period_s / period_s - 1) > 0.01:
        raise BadInputError(
            f"{data.name}: {1 / data.period_s:.1f} rows a second, others {1 / period_s:.1f};"
            " a discrete model needs one rate: fit them apart"
        )
    if not (np.isfinite(data.inputs).all() and np.isfinite(data.outputs).all()):
        raise BadInputError(f"{data.name}: input or output has holes; use a stretch without")
    if np.ptp(data.inputs) < 1e-9 * max(1.0, np.abs(data.inputs).max()) or not np.ptp(data.outputs):
        raise BadInputError(f"{data.name}: input or output is constant; excite the axis")
