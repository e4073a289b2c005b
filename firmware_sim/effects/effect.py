"""What each file of this folder defines: an effect as the stand-in has it, written apart.

Nothing here is the physics of ``groundstation``: a test flies both from one state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

G = 9.80665
POSITIVE = (0.0, math.inf)
ROTOR = (1.0, 4.0)
"""Limits of a size, and of the number of a rotor."""
Values = dict[str, float]
Draw = Callable[[np.random.Generator], Values]


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """parameters: name -> (default, unit). apply: (PARAMETERS record, values) puts it there.
    clear: takes what the plant has of it, or of the same physics, out of a record: a fitted model
    says it. present: what a record has of it, None where nothing is or where nobody asks. draw: a
    size that a craft may have. limits: parameter -> (least, most) that the plant can fly, any
    finite number without. listed: whether the design names it. hidden: its place among those that
    ``firmware_sim.hide`` hides, None: not there.
    """

    parameters: Mapping[str, tuple[float, str]]
    apply: Callable[[Any, Values], None]
    draw: Draw
    clear: Callable[[Any], None] = lambda p: None
    present: Callable[[Any], Values | None] = lambda p: None
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    listed: bool = True
    hidden: int | None = None


def sets(**fields: str) -> Callable[[Any, Values], None]:
    """Puts parameters into fields of the record as they stand: field=parameter."""

    def apply(p: Any, values: Values) -> None:
        for name, parameter in fields.items():
            p[name] = values[parameter]

    return apply


def zeroes(*fields: str) -> Callable[[Any], None]:
    """Empties fields of the record."""

    def clear(p: Any) -> None:
        for name in fields:
            p[name] = 0

    return clear


def reads(**fields: str) -> Callable[[Any], Values | None]:
    """What such fields hold, None where all are zero."""

    def present(p: Any) -> Values | None:
        values = {parameter: float(p[name]) for name, parameter in fields.items()}
        return values if any(values.values()) else None

    return present


def size(generator: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform."""
    return float(np.exp(generator.uniform(math.log(low), math.log(high))))


def one(parameter: str, low: float, high: float) -> Draw:
    """A single size."""
    return lambda generator: {parameter: size(generator, low, high)}


def vector(low: float, high: float, *parameters: str) -> Draw:
    """A size in a random direction."""

    def drawn(generator: np.random.Generator) -> Values:
        direction = generator.normal(size=len(parameters))
        turned = size(generator, low, high) * direction / np.linalg.norm(direction)
        return dict(zip(parameters, turned.tolist(), strict=True))

    return drawn


def each(**ranges: tuple[float, float]) -> Draw:
    """Several sizes, each from its range."""
    return lambda generator: {name: size(generator, *range_) for name, range_ in ranges.items()}


def fixed(**values: float) -> Draw:
    """Always the same."""
    return lambda generator: dict(values)
