"""The numbers that fits and the search estimate of an effect, and the way back to its parameters.

A point is a dictionary from key to value. Most unknowns are a parameter (``effect.parameter``); a
bandwidth is estimated as a time constant; an effect with a choice (which rotor) has one variant for
each, whose key is ``effect.1``, ``effect.2`` and so on (with ``.parameter`` where it has several
sizes).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from groundstation.dynamics.effect import Effect, Parameter


@dataclass(frozen=True, slots=True)
class Key:
    """An unknown: where it stands in a point, and the parameter behind it.

    absent: its value where the effect is not there. low, high: plausible values. worth: a size
    worth finding. step: of differences. All in the unknown's own unit.
    """

    key: str
    effect: Effect
    parameter: Parameter
    choice: int | None = None

    @property
    def unit(self) -> str:
        one = self.parameter
        return one.unit if one.unknown is None else one.unknown.unit

    @property
    def absent(self) -> float:
        one = self.parameter
        return one.to_unknown(one.default if one.kind == "shape" else one.absent)

    @property
    def plausible(self) -> tuple[float, float]:
        ends = (self.parameter.low, self.parameter.high)
        low, high = sorted(self.parameter.to_unknown(end) for end in ends)
        return low, high

    @property
    def bounds(self) -> tuple[float, float]:
        one = self.parameter
        if one.unknown is not None:
            return one.bounds
        return max(one.bounds[0], one.least), min(one.bounds[1], one.most)

    @property
    def worth(self) -> float:
        one = self.parameter
        if one.worth is not None:
            return one.worth
        return abs(one.to_unknown(one.default) - self.absent) or abs(one.default)

    @property
    def step(self) -> float:
        return self.parameter.step or 0.01 * max(self.worth, 1e-3 * abs(self.plausible[1]))


def variants(effect: Effect) -> tuple[tuple[Key, ...], ...]:
    """The ways in which an effect may be there, sizes before shapes: one, or one per choice."""
    choice = effect.choice
    numbers = [p for p in effect.parameters if p.kind == "size"]
    numbers += [p for p in effect.parameters if p.kind == "shape"]
    if choice is None:
        return (tuple(Key(f"{effect.name}.{_name(p)}", effect, p) for p in numbers),)
    found = []
    for which in range(int(choice.low), int(choice.high) + 1):
        stem = f"{effect.name}.{which}"
        keys = [stem if len(numbers) == 1 else f"{stem}.{_name(p)}" for p in numbers]
        found.append(
            tuple(Key(key, effect, p, which) for key, p in zip(keys, numbers, strict=True))
        )
    return tuple(found)


def to_point(effect: Effect, given: Mapping[str, float]) -> dict[str, float]:
    """Parameters as a point; those not given have their default."""
    values = effect.values(given)
    which = None if effect.choice is None else int(values[effect.choice.name])
    keys = next(keys for keys in variants(effect) if keys[0].choice == which)
    return {one.key: one.parameter.to_unknown(values[one.parameter.name]) for one in keys}


def to_values(keys: tuple[Key, ...], point: Mapping[str, float]) -> dict[str, float]:
    """A variant's parameters at a point, in the effect's order."""
    effect = keys[0].effect
    found = {
        one.parameter.name: one.parameter.from_unknown(point.get(one.key, one.absent))
        for one in keys
    }
    if effect.choice is not None and keys[0].choice is not None:
        found[effect.choice.name] = float(keys[0].choice)
    return {p.name: found[p.name] for p in effect.parameters}


def to_stderr(
    keys: tuple[Key, ...], point: Mapping[str, float], errors: Mapping[str, float]
) -> dict[str, float]:
    """Standard errors of a variant's parameters from those of its unknowns (first order)."""
    found = {}
    for one in keys:
        error = errors.get(one.key)
        if error is None:
            continue
        if one.parameter.unknown is not None:
            value = point.get(one.key, one.absent)
            ends = [one.parameter.from_unknown(value + sign * one.step) for sign in (1.0, -1.0)]
            error *= abs(ends[0] - ends[1]) / (2.0 * one.step)
        found[one.parameter.name] = error
    doubt = keys[0].effect.doubt
    if doubt is not None:
        for name, more in doubt(to_values(keys, point)).items():
            if name in found:
                found[name] = (found[name] ** 2 + more**2) ** 0.5
    return found


def _name(parameter: Parameter) -> str:
    return parameter.name if parameter.unknown is None else parameter.unknown.name
