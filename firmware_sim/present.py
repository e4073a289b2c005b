"""What a stand-in contains: effects with true values, and what its plant adds to a fitted model."""

from __future__ import annotations

import msgspec

from firmware_sim.effects.catalogue import EFFECTS
from firmware_sim.physics import craft_of, parameters
from firmware_sim.settings import StandInSettings
from groundstation.dynamics.model import EffectTerm, Estimate


def present_effects(settings: StandInSettings) -> dict[str, dict[str, float]]:
    """Every listed effect that the stand-in contains, hidden or always there: name -> parameter ->
    true value. The answer that a search is judged by."""
    p = parameters(settings)[0]
    found = {name: one.present(p) for name, one in EFFECTS.items() if one.listed}
    return {name: values for name, values in found.items() if values is not None}


def added_by_plant(settings: StandInSettings) -> str:
    """In a line, what the plant adds to a fitted model that flies in it; empty for nothing."""
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
    return f"not in the model, added by the plant: {'; '.join(added)}" if added else ""


def _unit(name: str, parameter: str) -> str:
    return EFFECTS[name].parameters[parameter][1]
