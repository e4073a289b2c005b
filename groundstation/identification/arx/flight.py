"""A model whose attitude is its ARX polynomials, on recorded inputs (thesis eq. 7.32-7.34).

The polynomials say how the craft turns, with their delay; thrust, and the kinematics between
angles and body rates, are those of the body.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import (
    SLOPE_ROWS,
    Model,
    arx_ahead,
    model_vehicle,
    of_rates,
    rotor_motors,
)
from groundstation.dynamics.rotations import body_rates, euler_rates
from groundstation.errors import BadInputError
from groundstation.identification.runs import Run
from groundstation.identification.torque import rotor_squares
from groundstation.prediction.prediction import Ahead
from groundstation.telemetry.arrays import AXES, Array

PART = 20_000
"""Starts flown at once, which bounds the memory."""


def with_arx_attitude(body: Ahead, model: Model, run: Run) -> Ahead:
    """What the body predicts of a run, with rates and angles by the model's ARX polynomials.

    Each prediction starts from the outputs that were measured until its first row. run: without
    holes in duty, supply, gyro and attitude.

    Raises BadInputError where the rows of the run and those of the model do not fit together.
    """
    polynomials = model.arx or {}
    every = _rows_per_step(model, run)
    inputs = rotor_squares(run, rotor_motors(model)).mixed(model_vehicle(model).configuration)
    inputs = _means(inputs, every)
    rates = of_rates(model)
    attitude = np.unwrap(run.attitude, axis=0)
    outputs = _means(run.gyro, every) if rates else attitude
    middle = 0.5 * (every - 1) if rates else 0.0  # a mean over rows is of the time between them
    longest = int(body.horizons[-1]) + int(np.ceil(middle))
    gyro, angles = body.gyro.copy(), body.attitude.copy()
    for first in range(0, len(body.rows), PART):
        part = slice(first, first + PART)
        starts = body.rows[part]
        flown = np.stack(
            [
                arx_ahead(polynomials[axis], inputs[:, i], outputs[:, i], starts, longest, every)
                for i, axis in enumerate(AXES)
            ],
            axis=-1,
        )
        if rates:
            flown = _at(flown, middle, int(body.horizons[-1]))
            turned = _integrated(flown, attitude[starts], run.period_s)
            gyro[part], angles[part] = flown[:, body.horizons], turned[:, body.horizons]
        else:
            gyro[part] = _slopes(flown, attitude, starts, body.horizons, every, run.period_s)
            angles[part] = flown[:, body.horizons]
    return replace(body, gyro=gyro, attitude=angles)


def _rows_per_step(model: Model, run: Run) -> int:
    (ts, *others) = {one.ts for one in (model.arx or {}).values()}
    every = round(ts / run.period_s)
    if others or every < 1 or abs(ts / (every * run.period_s) - 1.0) > 0.01:
        raise BadInputError(
            f"{run.name}: {1 / run.period_s:.1f} rows a second, the model's ARX polynomials make"
            f" {1 / ts:.1f} steps; fit them on recordings of this rate, or use --attitude body"
        )
    return every


def _means(values: Array, every: int) -> Array:
    """Means over the ``every`` rows that end with each row, (n, 3)."""
    sums = np.vstack([np.zeros((1, 3)), np.cumsum(values, axis=0)])
    last = np.arange(1, len(values) + 1)
    first = np.maximum(last - every, 0)
    return (sums[last] - sums[first]) / (last - first)[:, None]


def _at(flown: Array, later: float, longest: int) -> Array:
    """Values (m, longest + 1, 3) some rows later in (m, rows + 1, 3), on straight lines."""
    rows = later + np.arange(longest + 1.0)
    before = np.floor(rows).astype(np.int64)
    after = np.minimum(before + 1, flown.shape[1] - 1)
    share = (rows - before)[:, None]
    return (1.0 - share) * flown[:, before] + share * flown[:, after]


def _slopes(
    flown: Array,
    measured: Array,
    starts: NDArray[np.int64],
    horizons: NDArray[np.int64],
    every: int,
    period_s: float,
) -> Array:
    """Body rates (m, g, 3) of angles flown (m, rows + 1, 3), from what they turned lately."""
    span = max(SLOPE_ROWS, every)
    before = np.maximum(starts[:, None] + np.arange(-span, 0), 0)
    whole = np.concatenate([measured[before], flown], axis=1)
    turned = whole[:, horizons + span] - whole[:, horizons]
    return body_rates(flown[:, horizons], turned / (span * period_s))


def _integrated(rates: Array, attitude: Array, period_s: float) -> Array:
    """Angles (m, rows + 1, 3) of body rates over rows, from angles (m, 3) (eq. 3.11)."""
    turned = np.empty_like(rates)
    turned[:, 0] = attitude
    for row in range(1, rates.shape[1]):
        mean = 0.5 * (rates[:, row - 1] + rates[:, row])
        turned[:, row] = turned[:, row - 1] + period_s * euler_rates(turned[:, row - 1], mean)
    return turned
