"""The laws of effects on rows: which act at a point of the search, and what each gives for arrays.

A law takes numbers (``dynamics/law.py``). Most are plain arithmetic and take arrays (n,) of them as
well; one that branches, calls ``math`` or remembers is compiled and run row by row.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from groundstation.dynamics.effect import (
    VALUE_SLOTS,
    Body,
    Craft,
    Effect,
    Key,
    Reading,
    Stage,
    to_values,
)
from groundstation.telemetry.arrays import Array

STEPS_PER_RADIAN = 2.0
"""Steps of the integrator over the time constant of the fastest state: Runge-Kutta is then right
to one in a thousand of what the state still has to go."""


@dataclass(frozen=True, eq=False)
class Acting:
    """An effect that is there. values: of its parameters, in their order."""

    effect: Effect
    values: tuple[float, ...]

    @property
    def named(self) -> dict[str, float]:
        names = (one.name for one in self.effect.parameters)
        return dict(zip(names, self.values, strict=True))

    def law(self, *given: Any) -> Any:
        """Its law without states: ``given`` as in ``dynamics/law.py``, numbers or arrays (n,)."""
        with np.errstate(all="ignore"):
            try:
                return self.effect.law(self.values, *given)
            except (TypeError, ValueError):
                return _row_by_row(self, given)

    def body_law(self, craft: Craft, body: Any, period_s: float, mean: bool) -> Any:
        """Acceleration that an effect of the body adds, as ``law``, its states run along the rows.

        body: rows whose motion lasts over the period before each. mean: of the states over it;
        otherwise as they are at the row.
        """
        if not self.effect.states:
            return self.law(craft, body)
        return _row_by_row(self, (craft, body), period_s, mean)


def acting(keys: Sequence[Key], point: Mapping[str, float]) -> Acting | None:
    """The effect behind a variant's unknowns at a point, None where it is absent."""
    sizes = (one for one in keys if one.parameter.kind == "size")
    if all(point.get(one.key, one.absent) == one.absent for one in sizes):
        return None
    return Acting(keys[0].effect, tuple(to_values(tuple(keys), point).values()))


def in_order(effects: Iterable[Acting], stage: Stage) -> tuple[Acting, ...]:
    """Those of a stage in the order in which their laws act."""
    return tuple(sorted((one for one in effects if one.effect.stage == stage), key=_place))


def before(one: Acting, other: Acting) -> bool:
    """Whether an effect acts before another of its stage."""
    return _place(one) < _place(other)


def _place(one: Acting) -> tuple[int, str]:
    return one.effect.order, one.effect.name


def _row_by_row(
    one: Acting, given: tuple[Any, ...], period_s: float = 0.0, mean: bool = False
) -> Any:
    """A law of rotors, body or sensors as compiled code.

    One of the body that acts after others (``order``) is passed what they have made of the craft,
    as the chain of a flight passes it on, and what it adds is the difference.
    """
    from groundstation.dynamics.chains import own_address
    from groundstation.identification.likelihood.kernels import run_law

    effect, (craft, body, *passed) = one.effect, given
    count = len(body.height)
    rows = _columns(tuple(getattr(body, field) for field in Body._fields), count)
    late = effect.stage == "body" and effect.order > 0
    before = (body.angular, body.force) if late else (0.0,) * 6
    x = _columns(passed[0] if passed else before, count)
    values = np.zeros(VALUE_SLOTS)
    values[: len(one.values)] = one.values
    fastest = 0.0 if effect.fastest is None else effect.fastest(one.named)
    run_law(
        own_address(effect.stage, (effect,), (0,)),
        values,
        np.array(_flat(craft)),
        rows,
        np.array([state.initial for state in effect.states]),
        period_s,
        1 + int(STEPS_PER_RADIAN * fastest * period_s),
        mean,
        x,
    )
    if late:
        x -= _columns(before, count)
    found = tuple(np.ascontiguousarray(x.T))
    if effect.stage == "sensor":
        return Reading(found[:3], found[3:6], found[6:])
    return found if effect.stage == "rotor" else (found[:3], found[3:])


def _flat(given: Any) -> list[Any]:
    """The numbers of nested tuples in a row."""
    if not isinstance(given, tuple):
        return [given]
    return [number for part in given for number in _flat(part)]


def _columns(given: Any, count: int) -> Array:
    """(n, numbers) of nested tuples of arrays."""
    numbers = _flat(given)
    found = np.empty((count, len(numbers)))
    for place, one in enumerate(numbers):
        found[:, place] = one
    return found
