"""What lasts in a series is told from noise by its likelihood, over all lags."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from groundstation.discrepancy.disturbances import SHARES, drift_of, spread_of

STEP_S, PACES_S = 0.5, (0.3, 1.0, 3.0, 10.0)


def process(count, pace_s, spread, generator, step_s=STEP_S):
    kept = np.exp(-step_s / pace_s)
    driven = generator.normal(size=count) * np.sqrt(1.0 - kept**2)
    driven[0] /= np.sqrt(1.0 - kept**2)
    return spread * lfilter([1.0], [1.0, -kept], driven)


def minus_two_log_likelihood(values, pace_s, share):
    """From the whole covariance matrix, at the likeliest total variance."""
    told = np.flatnonzero(np.isfinite(values))
    apart = np.abs(told[:, None] - told[None, :]) * STEP_S
    shape = share * np.exp(-apart / pace_s) + (1.0 - share) * np.eye(len(told))

    def of(logarithm):
        return -2.0 * multivariate_normal.logpdf(values[told], cov=np.exp(logarithm) * shape)

    return minimize_scalar(of, bounds=(-6.0, 6.0), method="bounded", options={"xatol": 1e-9}).fun


def test_the_likelihood_is_that_of_the_whole_covariance():
    generator = np.random.default_rng(3)
    values = process(40, 3.0, 1.0, generator) + generator.normal(size=40)
    values[[5, 6, 30]] = np.nan
    drops, _ = drift_of([values[:, None]], STEP_S, PACES_S)
    white = minus_two_log_likelihood(values, 1.0, 0.0)
    for pace_s, drop in zip(PACES_S, drops[:, 0], strict=True):
        best = min(minus_two_log_likelihood(values, pace_s, share) for share in SHARES)
        assert drop == pytest.approx(max(white - best, 0.0), abs=1e-4)


def test_flights_of_ten_seconds_are_told_to_drift_where_neighbours_alone_are_too_few():
    generator = np.random.default_rng(4)
    drifting = np.column_stack([process(20, 3.0, 1.0, generator) for _ in range(100)])
    means = drifting + generator.normal(0.0, 0.1, (20, 100))
    alike = (means[:-1] * means[1:]).mean(axis=0) / np.square(means).mean(axis=0)
    assert (alike * np.sqrt(20.0) < 4.5).all()
    drops, _ = drift_of([means], STEP_S, PACES_S)
    assert (drops.max(axis=0) > 4.5**2).mean() > 1 / 3


def test_noise_is_seldom_taken_for_drift():
    generator = np.random.default_rng(5)
    drops, _ = drift_of([generator.normal(size=(40, 400))], STEP_S, PACES_S)
    assert (drops.max(axis=0) > 9.0).sum() <= 2


def test_flights_are_not_neighbours_of_each_other():
    generator = np.random.default_rng(6)
    lasting = np.full((20, 1), 5.0) + generator.normal(size=(20, 1))
    together, _ = drift_of([lasting, -lasting], STEP_S, PACES_S)
    joined, _ = drift_of([np.concatenate([lasting, -lasting])], STEP_S, PACES_S)
    assert together[3, 0] > joined[3, 0] + 5.0


def test_the_spread_of_a_process_is_told_from_means_over_the_step():
    generator = np.random.default_rng(7)
    fine = process(400_000, 1.0, 2.0, generator, step_s=0.01)
    means = fine.reshape(-1, 50).mean(axis=1)
    noisy = means + generator.normal(size=len(means))
    _, variances = drift_of([noisy[:, None]], STEP_S, PACES_S)
    assert spread_of(variances[1, 0], STEP_S, 1.0) == pytest.approx(2.0, rel=0.1)


def test_what_no_flight_tells_does_not_drift():
    drops, variances = drift_of([np.full((30, 2), np.nan), np.zeros((30, 2))], STEP_S, PACES_S)
    assert not drops.any()
    assert not variances.any()
