"""How certain the constants are: by the likelihood, by how much parts of the flights disagree, and
by how much an estimate moves with the band it is made in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.body.setup import CONSTANTS, DELAY, Setup
from groundstation.identification.estimate import inverse
from groundstation.identification.likelihood.free_spectra import Band, FreeFit, reweighted
from groundstation.identification.likelihood.residuals import value

Array = NDArray[np.float64]

BANDS: tuple[Band, ...] = ((0.3, 100.0), (1.0, 60.0), (2.0, 30.0))
YAW_BANDS = BANDS[:2]
"""Hz. A constant of the craft is the same in all of them. Above 2 Hz yaw answers to the change of
the rotors' speeds, not to their drag."""
BLOCK_S, LEAST_BLOCKS, LEAST_FLIGHTS = 5.0, 8, 4
"""Longer than what the spectra remember; scatter over fewer blocks says nothing."""
LINEAR = (*CONSTANTS, "slow_moment", "rotor_acceleration_torque")
"""Keys in which the residual is linear: re-estimated in each band."""
MOST_VARIANCE = 4.0
"""A band that holds less than a quarter of the information judges nothing."""
BY_CHANCE = 2.5
"""Standard deviations by which blocks or bands may disagree before it counts."""


def certain(setup: Setup, free: FreeFit) -> tuple[Array, dict[str, float]]:
    """Covariance (p, p), and for c0, c1, c2 the largest move between bands beyond chance.

    A move counts as an error of its own beside the likelihood's.
    """
    covariance = _by_blocks(setup, free, inverse(free.normal))
    moves = _moves(setup, free, covariance)
    for key, move in moves.items():
        covariance[setup.keys.index(key), setup.keys.index(key)] += move**2
    return covariance, moves


def _by_blocks(setup: Setup, free: FreeFit, plain: Array) -> Array:
    """The covariance, each parameter stretched by as much as blocks of time, or whole flights,
    scatter more than the likelihood says (a sandwich estimate, where it is certain)."""
    scores = _scores(setup, free)
    flights = sorted({flight for flight, _ in scores})
    groups = [
        np.array(list(scores.values())),
        np.array([sum(v for (f, _), v in scores.items() if f == flight) for flight in flights]),
    ]
    stretch = np.ones(len(plain))
    for group, least in zip(groups, (LEAST_BLOCKS, LEAST_FLIGHTS), strict=True):
        if len(group) >= least:
            ratio = ((group @ plain) ** 2).sum(axis=0) / np.diag(plain)
            chance = 1.0 + BY_CHANCE * np.sqrt(2.0 / len(group))
            stretch = np.maximum(stretch, np.sqrt(np.where(ratio > chance, ratio, 1.0)))
    return plain * np.outer(stretch, stretch)


def _scores(setup: Setup, free: FreeFit) -> dict[tuple[int, int], Array]:
    """Derivative (p,) of log L by flight and block of time: whitened series, multiplied row by
    row."""
    from scipy.fft import irfft

    sums: dict[tuple[int, int], Array] = {}
    for s, power, left in zip(free.linear.spectra, free.powers, free.left, strict=True):
        flight = setup.problem.flights[s.flight]
        size = round(1.0 / (s.hz[1] * s.period_s))
        energy = 0.5 * s.weight[1] * size
        real, imaginary = np.split(np.vstack([left, s.columns]), 2, axis=1)
        white = irfft((real + 1j * imaginary) * np.sqrt(energy / power), size, axis=1)
        rows = np.arange(flight.last - flight.first)
        count = max(1, round(len(rows) * s.period_s / BLOCK_S))
        for number, part in enumerate(np.array_split(rows, count)):
            score = sums.setdefault((s.flight, number), np.zeros(len(free.keys)))
            score[s.place] += white[1:, part] @ white[0, part]
    return sums


def _moves(setup: Setup, free: FreeFit, covariance: Array) -> dict[str, float]:
    """How far c0, c1, c2 move with the band, beyond what chance does; delays stay."""
    keys = setup.keys
    held = np.array([key == DELAY or not key.startswith(LINEAR) for key in keys])
    now = free.values
    open_ = np.where(held, 0.0, np.inf)
    found = dict.fromkeys((key for key in keys if key in CONSTANTS), 0.0)
    for band in BANDS:
        low, high = -open_, open_
        change, normal, _ = reweighted(free.linear, free.powers, low, high, band)
        moved = free.linear.point
        at = np.array([value(moved, key) for key in keys]) + change - now
        inside = inverse(normal)
        for key in found:
            if key == "c2" and band not in YAW_BANDS:
                continue
            place = keys.index(key)
            if inside[place, place] > MOST_VARIANCE * covariance[place, place]:
                continue
            extra = max(inside[place, place] - covariance[place, place], 0.0)
            least = 0.2 * covariance[place, place]
            excess = abs(at[place]) - BY_CHANCE * np.sqrt(max(extra, least))
            found[key] = max(found[key], float(excess))
    return found
