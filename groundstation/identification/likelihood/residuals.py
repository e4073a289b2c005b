"""What a model leaves unexplained in a flight, row by row, and what each unknown would add to it.

One-step residuals, not free runs (docs/discrepancy.md has the equations):

- gyro: mean angular acceleration between two rows, measured less modelled, rad/s^2;
- accelerometer: specific force, m/s^2;
- attitude, on its fresh rows: Euler rate less the kinematics of the measured gyro, rad/s;
- vertical: a flight's mean vertical specific force less 1 g, one number.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.columns import both_sides, column
from groundstation.identification.likelihood.evaluation import (
    ATTITUDE,
    Array,
    Columns,
    Evaluation,
)
from groundstation.identification.likelihood.frame import Frame
from groundstation.identification.likelihood.sensing import FORCES, RATES
from groundstation.telemetry.packet import STANDARD_GRAVITY

MAKING_FORCE = (None, "supply", "motor", "rotor", "body")
"""Stages that make the force itself, not how or when the accelerometer shows it."""


@dataclass(slots=True)
class Series:
    """Residuals and columns of one flight at one point.

    residual: channel -> rows. columns: key -> channel -> rows, d model / d key. vertical, lift:
    (residual, {key: derivative}) of the flight's mean vertical specific force less 1 g, as
    measured and as modelled, None without accelerometer or attitude. lasting: channel
    -> (k, rows), what a moment that never changes does, of 1 rad/s^2, or offsets of the gyro's
    axes, of 1 rad/s.
    """

    residual: Columns
    columns: dict[str, Columns]
    vertical: tuple[float, dict[str, float]] | None
    lift: tuple[float, dict[str, float]] | None
    lasting: Columns


def evaluate(
    flight: Flight,
    frame: Frame,
    point: Mapping[str, float],
    keys: Sequence[str],
    channels: Container[int] = range(9),
) -> Series:
    """Residuals of a flight at ``point`` and the columns of ``keys``.

    channels: what is asked for; the vertical rows belong to the accelerometer's. A sensor of which
    no channel is wanted is left out, one axis more of a wanted one may come along.
    """
    at = Evaluation(flight, frame, point, channels)
    residual: Columns = {}
    run = flight.run
    if RATES in at.parts:
        measured = np.diff(run.gyro, axis=0, prepend=run.gyro[:1]) / at.period
        at.put(RATES, residual, measured - at.angular_read)
    if FORCES in at.parts:
        modelled = at.as_read(FORCES, at.force_read)
        at.put(FORCES, residual, run.accelerometer - modelled)
    lasting = {i: np.ones((1, len(residual[i]))) for i in range(3) if i in residual}
    rows = at.rows_of_attitude
    if rows is not None:
        modelled = at.turning(at.sensors, at.lean, at.felt.off)
        euler = rows.where_told(rows.rate - modelled)
        residual.update({ATTITUDE + i: euler[:, i] for i in range(3)})
        told = rows.where_told(rows.to_euler)
        lasting |= {ATTITUDE + i: np.ascontiguousarray(told[:, i].T) for i in range(3)}
    columns = {key: column(at, key) for key in keys}
    up = (_vertical(at, keys), _lift(at, columns)) if FORCES in at.parts else (None, None)
    return Series(residual, columns, *up, lasting)


def rate_errors(
    flight: Flight, frame: Frame, point: Mapping[str, float], gains: Sequence[float]
) -> Array:
    """Mean squared one-step prediction errors (gains, 3) of the rates, (rad/s)^2."""
    evaluation = Evaluation(flight, frame, point)
    return np.array([evaluation.find_rates((gain, gain, gain)) for gain in gains])


def generic_signals(flight: Flight, frame: Frame, point: Mapping[str, float]) -> dict[str, Array]:
    """Signals (n,) that something unknown may go with: words -> values at every row."""
    return Evaluation(flight, frame, point).generic()


def _vertical(at: Evaluation, keys: Sequence[str]) -> tuple[float, dict[str, float]] | None:
    """The mean vertical force as measured, less what the accelerometer adds, less 1 g."""
    if at.flight.up is None:
        return None
    up, mean = at.flight.up
    slopes: dict[str, float] = {}
    for key in keys:
        if at.stage(key) == "sensor":
            high, _, step = both_sides(at, at.frame.unknowns[key])
            change = at.sensors_with(high).offset - at.sensors.offset
            slope = float(up @ change[FORCES]) / step
            slopes |= {key: slope} if slope else {}
    return mean - float(up @ at.sensors.offset[FORCES]) - STANDARD_GRAVITY, slopes


def _lift(at: Evaluation, columns: Mapping[str, Columns]) -> tuple[float, dict[str, float]] | None:
    """1 g less what the model says of the mean vertical force while airborne."""
    if at.flight.up is None:
        return None
    up = at.flight.upward @ at.sensors.turn.T
    _, force = at.sensors.in_body(at.angular_read, at.force_read, at.passing[-1], at.period)
    mean = float(np.einsum("ni,ni->n", up, force[at.flight.rows]).mean())
    up = up @ at.sensors.undo[FORCES, FORCES]
    slopes = {
        key: float(sum((up[:, c - 3] * v).mean() for c, v in rows.items() if 3 <= c < 6))
        for key, rows in columns.items()
        if at.stage(key) in MAKING_FORCE
    }
    return STANDARD_GRAVITY - mean, slopes
