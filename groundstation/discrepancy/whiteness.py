"""What no effect explains: whether residuals are structured, where, and what they go with.

Two tests, because each is blind to what the other sees. A scan regresses every channel's residual
on generic signals (rates, their products, rotor sums, velocity, tilt); a resonance or a push from
outside goes with none of them, but rises above the smooth spectrum of coloured noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.comparison.gap import CHANNELS
from groundstation.discrepancy.findings import Leftover
from groundstation.identification.estimate import inverse
from groundstation.identification.flight import LEAK_S, LEANING_LEAK_S, Flight
from groundstation.identification.likelihood.evaluation import generic_signals
from groundstation.identification.likelihood.motion import Frame, spin_rotors
from groundstation.identification.likelihood.problem import Fit, Problem
from groundstation.identification.likelihood.spectra import (
    Linear,
    Spectrum,
    beside_lasting,
    transform_channel,
)
from groundstation.telemetry.arrays import Array

SCAN_DROP = 45.0
"""Drop of -2 log L from which a generic signal counts: 6.7 standard deviations."""
FINE_HZ = 0.25
BASELINE_SHARE, BASELINE_HZ = 0.35, 4.0
"""The smooth spectrum is a running median over this share of the frequency, or this far."""
EXCESS, FAR = 1.7, 5.8
"""Rises count from this ratio and this many standard deviations: 1 in 10^8 each."""

VELOCITY_DOUBT, LEANING_DOUBT, HEIGHT_DOUBT = 0.015, 0.1, 0.15
"""Shares of the power of what goes with velocity or height that reckoning them costs, beside what
the leak of a velocity takes; the most that was seen against the stand-in's truth."""
APART_HZ, APART_SHARE = 1.0, 0.02
"""Frequencies nearer to each other are one."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A generic signal that shows in a channel: drop of -2 log L."""

    channel: int
    words: str
    drop: float


def leftover(problem: Problem, fit: Fit) -> Leftover:
    """Judge what a fit leaves."""
    signals = [s for s in scan(problem, fit) if s.drop > SCAN_DROP]
    known = problem.frame.unknowns
    sizes = [key for key in fit.keys if key in known and known[key].parameter.kind == "size"]
    reckoned = [key for key in sizes if known[key].effect.unmeasured]
    linear = problem.linear(fit.point, reckoned, problem.flights)
    peaks = rises(linear, [excused(s, linear, problem.frame) for s in linear.spectra])
    if not signals and not peaks:
        return Leftover("white")
    by_channel: dict[int, float] = {}
    for signal in signals:
        by_channel[signal.channel] = max(by_channel.get(signal.channel, 0.0), signal.drop)
    for channel, _, ratio, freedom in peaks:
        gained = freedom * (ratio - 1.0 - np.log(ratio))
        by_channel[channel] = max(by_channel.get(channel, 0.0), gained)
    worst = max(by_channel, key=lambda c: by_channel[c])
    mine = sorted((p for p in peaks if p[0] == worst), key=lambda p: -p[2])
    best = max((s for s in signals if s.channel == worst), key=lambda s: s.drop, default=None)
    words = best.words if best is not None else ""
    period = problem.flights[0].period_s
    rotors = [spin_rotors(f, fit.point, problem.frame).end[f.rows] for f in problem.flights]
    rotor_hz = float(np.mean([speeds.mean() for speeds in rotors]))
    # Vibration is told by its fold at the sample rate.
    fold = abs(rotor_hz - round(rotor_hz * period) / period)
    if mine and abs(mine[0][1] - fold) < 0.08 * rotor_hz:
        words = words or "the rotors' speed, folded at the sample rate: a propeller out of balance"
    elif mine and not words:
        words = "an oscillation that no recorded signal goes with"
    return Leftover(
        "structured",
        CHANNELS[worst],
        tuple(round(hz, 2) for hz in _apart([p[1] for p in mine])[:5]),
        words,
        max((p[2] for p in mine), default=1.0),
    )


def scan(problem: Problem, fit: Fit) -> list[Signal]:
    """Every generic signal against every channel's residual, best first.

    What the fitted unknowns can imitate is taken out by fitting them along, channel by channel.
    """
    every = _with_signals(problem, fit, problem.flights)
    found = []
    channels = sorted({s.channel for s in every[0].spectra})
    for channel in channels:
        own = [s for s in every[0].spectra if s.channel == channel]
        known = len(fit.keys)
        normal, gradient = _sums(problem, own, known + len(every[1]))
        inner = inverse(normal[:known, :known] + np.diag(_floor(normal, known)))
        cross = normal[known:, :known]
        left = np.diag(normal)[known:] - np.einsum("ij,jk,ik->i", cross, inner, cross)
        slope = gradient[known:] - cross @ (inner @ gradient[:known])
        alive = left > 1e-6 * np.maximum(np.diag(normal)[known:], 1e-300)
        drops = np.where(alive, slope**2 / np.where(alive, left, 1.0), 0.0)
        found += [
            Signal(channel, words, float(drop)) for words, drop in zip(every[1], drops, strict=True)
        ]
    return sorted(found, key=lambda s: -s.drop)


def excused(spectrum: Spectrum, linear: Linear, frame: Frame) -> Array:
    """Power (2 m,) that effects of velocity and height leave when they are exactly right.

    Neither is measured. A leaky integral of velocity lacks (1 + 1/(j w T))^2 - 1 of the true one
    at low frequency; an attitude that leans costs more than one that does not.
    """
    acting = frame.acting(linear.point).values()
    leaning = any(one.effect.stage == "attitude" and one.law()[0] > 0.0 for one in acting)
    leak, doubt = (LEANING_LEAK_S, LEANING_DOUBT) if leaning else (LEAK_S, VELOCITY_DOUBT)
    slow = 2.0 * (2.0 / (leak * 2.0 * np.pi * np.maximum(spectrum.hz, 1e-3))) ** 2
    share = {"velocity": np.minimum(slow + doubt, 1.0), "height": np.full_like(slow, HEIGHT_DOUBT)}
    power = np.zeros(len(spectrum.hz))
    for place, column in zip(spectrum.place, spectrum.columns, strict=True):
        one = frame.unknowns[linear.keys[place]]
        size = (linear.point[one.key] - one.absent) * column
        for what in one.effect.unmeasured:
            power += share[what] * size**2
    return power


def _apart(hz: Sequence[float]) -> list[float]:
    """Frequencies, strongest first, without those that are near a stronger one."""
    kept: list[float] = []
    for one in hz:
        if all(abs(one - other) > max(APART_HZ, APART_SHARE * other) for other in kept):
            kept.append(one)
    return kept


def rises(linear: Linear, known: Sequence[Array]) -> list[tuple[int, float, float, float]]:
    """(channel, Hz, power over that of smooth coloured noise, degrees of freedom) of what rises
    above it. known: power (2 m,) of each spectrum that is no surprise beside the noise."""
    found = []
    for channel in sorted({s.channel for s in linear.spectra}):
        own = [(s, k) for s, k in zip(linear.spectra, known, strict=True) if s.channel == channel]
        top = max(s.hz.max() for s, _ in own)
        edges = np.arange(0.0, top + FINE_HZ, FINE_HZ)
        power, excuse, freedom = np.zeros((3, len(edges) - 1))
        for s, expected in own:
            band = np.minimum((s.hz / FINE_HZ).astype(np.int64), len(power) - 1)
            power += np.bincount(band, s.weight * s.residual**2, len(power))
            excuse += np.bincount(band, s.weight * expected, len(power))
            freedom += 0.5 * np.bincount(band, s.weight, len(power))
        middle = edges[:-1] + 0.5 * FINE_HZ
        full = freedom > 0.5 * np.median(freedom)
        middle, level = middle[full], (power / np.maximum(freedom, 1e-9))[full]
        beside = (excuse / np.maximum(freedom, 1e-9))[full]
        count = float(np.median(freedom))
        # The median of chi-squared and its far quantile, over its mean (Wilson and Hilferty).
        step = 2.0 / (9.0 * count)
        limit = max(EXCESS, float((1.0 - step + FAR * np.sqrt(step)) ** 3))
        reach = np.maximum(BASELINE_SHARE * middle, BASELINE_HZ)
        first = np.searchsorted(middle, middle - reach)
        last = np.searchsorted(middle, middle + reach)
        for i in range(len(level)):
            smooth = median_of(level[first[i] : last[i]]) / (1.0 - step) ** 3
            ratio = float(level[i] / (smooth + beside[i]))
            if ratio > limit:
                found.append((channel, float(middle[i]), ratio, count))
    return found


def median_of(values: Array) -> float:
    """numpy's, for finite values, at a third of its time on a few hundred."""
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    low, high = np.partition(values, (half - 1, half))[half - 1 : half + 1].tolist()
    return float(0.5 * (low + high))


def _with_signals(
    problem: Problem, fit: Fit, flights: Sequence[Flight]
) -> tuple[Linear, list[str]]:
    """The fit's linearisation with the generic signals as more columns of every channel."""
    linear = problem.linear(fit.point, fit.keys, flights)
    words: list[str] = []
    wider: list[Spectrum] = []
    for number, flight in enumerate(flights):
        signals = generic_signals(flight, problem.frame, fit.point)
        words = list(signals)
        places = np.arange(len(fit.keys), len(fit.keys) + len(words))
        for s in linear.spectra:
            if s.flight == number:
                columns = transform_channel(signals, s.channel, flight)
                columns = columns / problem.root(flight, s.channel, s.hz)
                columns = beside_lasting(s, columns, problem.noise[s.channel])
                wider.append(
                    replace(
                        s,
                        columns=np.concatenate([s.columns, columns]),
                        place=np.concatenate([s.place, places]),
                    )
                )
    return replace(linear, spectra=wider), words


def _sums(problem: Problem, spectra: Sequence[Spectrum], count: int) -> tuple[Array, Array]:
    normal, gradient = np.zeros((count, count)), np.zeros(count)
    for s in spectra:
        root = np.sqrt(s.weight / problem.noise[s.channel].at(s.hz))
        white = s.columns * root
        normal[np.ix_(s.place, s.place)] += white @ white.T
        gradient[s.place] += white @ (s.residual * root)
    return normal, gradient


def _floor(normal: Array, known: int) -> Array:
    """A little of the diagonal, for unknowns that one channel alone does not show."""
    diagonal = np.diag(normal)[:known]
    return np.where(diagonal > 0, 1e-9 * diagonal, 1.0)
