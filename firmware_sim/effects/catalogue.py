"""Which effects can be hidden in a craft: one file of this folder each, found by being there.

Every name of the design that has a file here, and four that no list contains. Nothing of this
reaches a packet or a recording's metadata.
"""

from __future__ import annotations

import math
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

import numpy as np

import firmware_sim.effects
from firmware_sim.effects.effect import Effect
from groundstation.dynamics.registry import EFFECTS as NAMED

_PACKAGE = firmware_sim.effects
_MODULES = [
    import_module(f"{_PACKAGE.__name__}.{name}")
    for name in sorted(
        one.name for one in iter_modules(_PACKAGE.__path__) if one.name != "catalogue"
    )
]
EFFECTS: dict[str, Effect] = {
    module.__name__.rpartition(".")[2]: module.EFFECT
    for module in _MODULES
    if hasattr(module, "EFFECT")
}


def apply_effects(p: Any, effects: dict[str, dict[str, float]]) -> None:
    """Put effects into a PARAMETERS record.

    Raises ValueError for a name or a parameter that does not exist, or a value out of limits.
    """
    for name, given in effects.items():
        if name not in EFFECTS:
            raise ValueError(f"effect {name!r}: there are {', '.join(sorted(EFFECTS))}")
        effect = EFFECTS[name]
        unknown = set(given) - set(effect.parameters)
        if unknown:
            raise ValueError(
                f"effect {name}: no parameter {', '.join(sorted(unknown))};"
                f" there are {', '.join(effect.parameters)}"
            )
        values = {key: given.get(key, default) for key, (default, _) in effect.parameters.items()}
        for key, value in values.items():
            low, high = effect.limits.get(key, (-math.inf, math.inf))
            if not (low <= value <= high and math.isfinite(value)):
                raise ValueError(
                    f"effect {name}: {key} is {value}, must be finite and in [{low:g}, {high:g}]"
                )
            if key == "rotor" and value != int(value):
                raise ValueError(f"effect {name}: rotor is {value}, must be 1, 2, 3 or 4")
        if name in NAMED:
            NAMED[name].require_sizes(values)
        effect.apply(p, values)


def replace_effects(p: Any, effects: dict[str, dict[str, float]]) -> None:
    """Put effects of a fitted model into a PARAMETERS record, in the place of what the plant has of
    the same."""
    for name in effects:
        EFFECTS[name].clear(p)
    apply_effects(p, effects)


def draw(name: str, generator: np.random.Generator) -> dict[str, float]:
    """Parameters of an effect from the ranges that a craft may have: log-uniform size, random sign
    or direction."""
    return EFFECTS[name].draw(generator)
