"""How well a body model predicts flights it has not seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from groundstation.identification.body.fit import BodyFit, vertical
from groundstation.identification.body.foretelling import foretold, learnt
from groundstation.identification.body.setup import Setup, on_other
from groundstation.identification.estimate import fit_percent, rms
from groundstation.identification.likelihood.free_spectra import minimum_phase_whitener
from groundstation.identification.likelihood.parameters import Point
from groundstation.identification.stretches import Stretch
from groundstation.telemetry.arrays import AXES, Array

HORIZONS_S = (0.02, 0.05)
SHAKEN_S = 0.05
"""The rotors shake the accelerometer by many times what the craft does: means are compared."""


def validate_body(stretches: Sequence[Stretch], fit: BodyFit) -> dict[str, float]:
    """Held-out figures: per axis the RMS errors at one row, 20 and 50 ms (rad/s) and the fit %
    at 20 and 50 ms, and both for the vertical specific force (m/s^2, means over 50 ms). They are
    those of the model that is saved: what was fitted along and left out does not help it."""
    figures: dict[str, float] = {}
    setup = on_other(fit.setup, stretches)
    for horizon in (0.0, *HORIZONS_S):
        label = f"{horizon * 1e3:.0f}ms" if horizon else "1row"
        pairs = predicted_rates(fit, setup, fit.saved, horizon)
        measured = np.vstack([one for one, _ in pairs])
        modelled = np.vstack([other for _, other in pairs])
        for axis, name in enumerate(AXES):
            figures[f"gyro_{name}_rms_{label}"] = rms(measured[:, axis] - modelled[:, axis])
            if horizon:
                figures[f"gyro_{name}_fit_percent_{label}"] = fit_percent(
                    measured[:, axis], modelled[:, axis]
                )
    measured, squares = vertical(setup, fit.saved)
    rows = max(1, round(SHAKEN_S / stretches[0].run.period_s))
    if len(measured) >= 2 * rows:
        measured, squares = (_means(one, rows) for one in (measured, squares))
        modelled = fit.body.thrust_per_mass * squares
        figures["accelerometer_z_rms"] = rms(measured - modelled)
        figures["accelerometer_z_fit_percent"] = fit_percent(measured, modelled)
    return figures


def predicted_rates(
    fit: BodyFit, setup: Setup, point: Point, horizon_s: float = 0.0
) -> list[tuple[Array, Array]]:
    """(measured, predicted) rates (k, 3) in rad/s of each flight, predicted ``horizon_s`` before.

    A prediction starts at a measured rate and knows nothing of the future but the motors' inputs:
    the air's moment stays as it is, and what has turned the craft beside the model goes on as
    the errors of the past foretell (``foretelling``). The shortest horizon is one row, the first
    prediction belongs to row ``horizon``.
    """
    period = setup.problem.flights[0].period_s
    rows = max(1, round(horizon_s / period))
    fitted = fit.setup.residuals(point)
    before = [learnt([one[:, axis] for one in fitted], rows, period) for axis in range(3)]
    found = []
    lasting, residuals = setup.slow_moments(point), setup.residuals(point)
    for flight, left, slow in zip(setup.problem.flights, residuals, lasting, strict=True):
        measured = flight.run.gyro[flight.first - 1 : flight.last]
        expected = np.column_stack(
            [foretold(left[:, axis], rows, period, before[axis]) for axis in range(3)]
        )
        expected += rows * np.vstack([slow[:1], slow[:-1]])[: len(expected)]
        sums = np.vstack([np.zeros(3), np.cumsum(left + slow, axis=0)])
        wrong = sums[rows:] - sums[:-rows] - expected
        found.append((measured[rows:], measured[rows:] - period * wrong))
    return found


def prediction_residuals(stretch: Stretch, fit: BodyFit) -> Array:
    """One-step errors (n, 3) of a fit, whitened by the mean spectrum of the flights it was made
    on, in standard deviations; the first rows are NaN, all where the stretch is shorter than the
    whitener."""
    (left,) = on_other(fit.setup, [stretch]).residuals(fit.point)
    out = np.full(left.shape, np.nan)
    for axis in range(3):
        whitener = minimum_phase_whitener(fit.free, axis)
        if len(left) >= len(whitener):  # numpy exchanges the two where it is shorter
            out[len(whitener) - 1 :, axis] = np.convolve(left[:, axis], whitener, "valid")
    return out


def _means(values: Array, rows: int) -> Array:
    """Means over blocks of so many rows."""
    whole = len(values) // rows * rows
    return values[:whole].reshape(-1, rows).mean(axis=1)
