"""How well a body model predicts flights it has not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.vehicle import Vehicle
from groundstation.identification.body import BodyFit, vertical
from groundstation.identification.body_problem import AXES
from groundstation.identification.body_terms import BodyTerms, measured_acceleration
from groundstation.identification.estimate import fit_percent, rms
from groundstation.identification.stretches import Stretch

Array = NDArray[np.float64]

HORIZONS_S = (0.02, 0.05)
SHAKEN_S = 0.05
"""The rotors shake the accelerometer by many times what the craft does: means are compared."""


def validate_body(stretches: Sequence[Stretch], fit: BodyFit) -> dict[str, float]:
    """Held-out figures: per axis the RMS errors at one row, 20 and 50 ms (rad/s) and the fit %
    at 20 and 50 ms, and both for the vertical specific force (m/s^2, means over 50 ms)."""
    figures: dict[str, float] = {}
    for horizon in (0.0, *HORIZONS_S):
        label = f"{horizon * 1e3:.0f}ms" if horizon else "1row"
        pairs = [predicted_rates(one, fit.model, fit.values, horizon) for one in stretches]
        measured = np.vstack([one for one, _ in pairs])
        modelled = np.vstack([other for _, other in pairs])
        for axis, name in enumerate(AXES):
            figures[f"gyro_{name}_rms_{label}"] = rms(measured[:, axis] - modelled[:, axis])
            if horizon:
                figures[f"gyro_{name}_fit_percent_{label}"] = fit_percent(
                    measured[:, axis], modelled[:, axis]
                )
    measured, squares = vertical(stretches, fit.model, fit.values)
    rows = max(1, round(SHAKEN_S / stretches[0].run.period_s))
    if len(measured) >= 2 * rows:
        measured, squares = (_means(one, rows) for one in (measured, squares))
        modelled = fit.body.thrust_per_mass * squares
        figures["accelerometer_z_rms"] = rms(measured - modelled)
        figures["accelerometer_z_fit_percent"] = fit_percent(measured, modelled)
    return figures


def predicted_rates(
    stretch: Stretch, model: BodyTerms, values: Mapping[str, float], horizon_s: float = 0.0
) -> tuple[Array, Array]:
    """(measured, predicted) rates (k, 3) in rad/s, each predicted ``horizon_s`` before its row.

    A prediction starts at a measured rate and knows nothing of the future but the motors'
    inputs. The shortest horizon is one row, the first prediction belongs to row ``horizon``.
    """
    rows = max(1, round(horizon_s / stretch.run.period_s))
    steps = model.acceleration(stretch, values) * stretch.run.period_s
    sums = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    measured = stretch.run.gyro[stretch.first - 1 : stretch.last]
    return measured[rows:], measured[:-rows] + sums[rows:] - sums[:-rows]


def prediction_errors(
    stretches: Sequence[Stretch],
    model: BodyTerms,
    values: Mapping[str, float],
    horizon_s: float = 0.0,
) -> Array:
    """RMS errors (3,) in rad/s of ``predicted_rates`` over all stretches."""
    errors = [
        measured - predicted
        for measured, predicted in (
            predicted_rates(one, model, values, horizon_s) for one in stretches
        )
    ]
    return np.sqrt(np.mean(np.square(np.vstack(errors)), axis=0))


def prediction_residuals(stretch: Stretch, fit: BodyFit) -> Array:
    """Whitened one-step errors (n, 3) of a fit, in standard deviations; the first rows are NaN."""
    errors = measured_acceleration(stretch) - fit.model.acceleration(stretch, fit.values)
    out = np.full(errors.shape, np.nan)
    for axis, noise in enumerate(fit.noise):
        white = noise.whiten(errors[:, axis]) / np.sqrt(noise.variance)
        out[len(errors) - len(white) :, axis] = white
    return out


def fit_free_run(stretches: Sequence[Stretch], vehicle: Vehicle) -> Array:
    """c0, c1, c2 by simulating whole stretches and matching the rates: what not to do.

    Kept to be shown beside ``fit_body``: every torque disturbance stays in the integral for ever,
    and in closed loop the controller's answer to it is taken for the cause.
    """
    model, unit = BodyTerms(vehicle, 1.0), {"c0": 1.0, "c1": 1.0, "c2": 1.0}
    top, bottom = np.zeros(3), np.zeros(3)
    for stretch in stretches:
        simulated = np.cumsum(model.acceleration(stretch, unit), axis=0) * stretch.run.period_s
        rate = stretch.run.gyro[stretch.rows]
        simulated, rate = simulated - simulated.mean(axis=0), rate - rate.mean(axis=0)
        top += (simulated * rate).sum(axis=0)
        bottom += (simulated**2).sum(axis=0)
    return np.asarray(top / bottom)


def _means(values: Array, rows: int) -> Array:
    """Means over blocks of so many rows."""
    whole = len(values) // rows * rows
    return np.asarray(values[:whole].reshape(-1, rows).mean(axis=1))
