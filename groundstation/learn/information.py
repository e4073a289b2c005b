"""What manoeuvres tell of a craft: expected information on each constant and each effect, and the
set with the most of it (D-optimal, greedy over manoeuvres)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.dynamics.model import Model
from groundstation.identification.estimate import inverse
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import BODY_KEYS, KEYS, point_of
from groundstation.identification.likelihood.problem import Problem
from groundstation.identification.likelihood.spectra import quadratic
from groundstation.identification.runs import Run
from groundstation.telemetry.arrays import Array

BODY_DOUBT = 0.3
"""Of c0, c1, c2 and the thrust before any flight, as a share."""
LITTLE = 0.02
"""Gain a second of flight (nats) below which nothing more is planned."""


@dataclass(frozen=True, slots=True)
class Information:
    """keys: constants and sizes of effects. prior: what is known of them, (p, p). parts: by name of
    a manoeuvre what flying it adds, (p, p), and what the same time of hover would not."""

    keys: tuple[str, ...]
    prior: Array
    parts: Mapping[str, Array]

    def errors(self, flown: Sequence[str]) -> dict[str, float]:
        """Standard errors by key that these manoeuvres would leave, all fitted jointly."""
        errors = np.sqrt(np.diag(inverse(self._known(flown))))
        return dict(zip(self.keys, errors.tolist(), strict=True))

    def gain(self, flown: Sequence[str], more: str) -> float:
        """By how much one more manoeuvre shrinks what is open, in nats."""
        known = self._known(flown)
        return 0.5 * (_volume(known + self.parts[more]) - _volume(known))

    def _known(self, flown: Sequence[str]) -> Array:
        return self.prior + sum((self.parts[name] for name in flown), np.zeros_like(self.prior))


@dataclass(frozen=True, slots=True)
class Choice:
    """A manoeuvre that was chosen: gain in nats, and the keys of which it tells the most."""

    name: str
    gain: float
    tells: tuple[str, ...]


def _volume(normal: Array) -> float:
    return float(np.linalg.slogdet(normal)[1])


def information_of(
    runs: Mapping[str, Run], model: Model, known: Mapping[str, float] | None = None
) -> Information:
    """From flights of ``model``, one of each manoeuvre by name.

    Residuals there are noise alone; their slopes by every constant and every effect that is fitted,
    weighted by the noise, are the expected information. known: standard errors of effects' sizes
    that flights have given already, by key; of others nothing is known but the size worth finding.
    """
    named = [replace(run, name=name) for name, run in runs.items()]
    flights = prepare(named, least_s=3.0)
    point = point_of(model)
    problem = Problem(flights, model, point)
    problem.settle_filters()
    linear = problem.learn_noise(problem.linear(point, problem.every_key, flights))
    keys = tuple(linear.keys)
    parts = {name: np.zeros((len(keys),) * 2) for name in runs}
    for number, flight in enumerate(flights):
        own = [s for s in linear.spectra if s.flight == number]
        parts[flight.run.name] += quadratic(own, problem.noise, (), len(keys)).normal
    spread = dict(known or {})
    doubts = [_doubt(key, point, spread) for key in keys]
    prior = np.diag([0.0 if doubt is None else doubt**-2 for doubt in doubts])
    for one in problem.prior:
        if set(one.keys) <= set(keys):
            at = linear.place(one.keys)
            prior[np.ix_(at, at)] += one.at(point)[0]
    scale = np.array([_scale(key, point) for key in keys])
    _require_definite(prior, scale)
    return Information(keys, prior, parts)


def _doubt(key: str, point: Mapping[str, float], known: Mapping[str, float]) -> float | None:
    """Standard deviation of a number before the flight; None where the problem's prior says it."""
    if key in known:
        return known[key]
    if key in BODY_KEYS:
        return BODY_DOUBT * abs(point[key])
    if key in KEYS:
        return KEYS[key].worth
    return None


def _scale(key: str, point: Mapping[str, float]) -> float:
    return KEYS[key].worth if key in KEYS else abs(point.get(key, 1.0)) or 1.0


def _require_definite(prior: Array, scale: Array) -> None:
    """What no prior holds is held by its own size: every volume is finite then."""
    for i, one in enumerate(np.diag(prior)):
        if one <= 0.0:
            prior[i, i] = scale[i] ** -2


def choose(
    told: Information,
    seconds: Mapping[str, float],
    budget_s: float,
    least: float = LITTLE,
    flown: Sequence[str] = (),
) -> list[Choice]:
    """The manoeuvres with the most information a second, one after the other, each as often as it
    still tells more than the others; until the time is spent or the best gains less than ``least``
    nats a second. flown: those that were flown before."""
    chosen: list[Choice] = []
    left_s = budget_s
    while True:
        names = [*flown, *(one.name for one in chosen)]
        fitting = [name for name in told.parts if seconds[name] <= left_s]
        gains = {name: told.gain(names, name) for name in fitting}
        best = max(fitting, key=lambda name: gains[name] / seconds[name], default=None)
        if best is None or gains[best] < least * seconds[best]:
            return chosen
        before, after = told.errors(names), told.errors([*names, best])
        shrunk = sorted(told.keys, key=lambda key: after[key] / before[key])
        chosen.append(Choice(best, gains[best], tuple(shrunk[:3])))
        left_s -= seconds[best]
