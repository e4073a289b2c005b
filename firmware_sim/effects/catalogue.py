"""Which effects can be hidden in a craft: one file of this folder each, found by being there.

Every name of the design that has a file here, and four that no list contains. Nothing of this
reaches a packet or a recording's metadata.
"""

from __future__ import annotations

import math
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

import msgspec
import numpy as np

import firmware_sim.effects
from firmware_sim.effects.effect import Effect
from firmware_sim.settings import StandInSettings
from groundstation.dynamics.arx import arx_labels, turning_of
from groundstation.dynamics.model import EffectTerm, Estimate
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


def present_effects(settings: StandInSettings) -> dict[str, dict[str, float]]:
    """Every listed effect that the stand-in contains, hidden or always there: name -> parameter ->
    true value. The answer that a search is judged by."""
    from firmware_sim.physics import parameters

    p = parameters(settings)[0]
    found = {name: one.present(p) for name, one in EFFECTS.items() if one.listed}
    return {name: values for name, values in found.items() if values is not None}


def added_by_plant(settings: StandInSettings) -> str:
    """In a line, what the plant adds to a fitted model that flies in it; empty for nothing."""
    from firmware_sim.physics import craft_of, parameters

    _, model = craft_of(settings)
    if model is None:
        return ""
    plain = msgspec.structs.replace(settings, effects={})
    known = {term.name for term in model.effects}
    added = [
        repr(EffectTerm(name, {k: Estimate(v, unit=_unit(name, k)) for k, v in values.items()}))
        for name, values in present_effects(plain).items()
        if name not in known
    ]
    if model.origin.get("body") == "profile":
        added.insert(0, f"body constants of the profile {model.vehicle}")
    if parameters(plain)[0]["shake"].any():
        added.append("vibration")
    beside = f"not in the model, added by the plant: {'; '.join(added)}" if added else ""
    if turning_of(model, settings.attitude) == "body":
        return beside
    turns = f"the craft turns by its ARX polynomials ({arx_labels(model)}), thrust is the body's"
    return f"{turns}; {beside}" if beside else turns


def _unit(name: str, parameter: str) -> str:
    return EFFECTS[name].parameters[parameter][1]
