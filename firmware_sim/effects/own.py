"""A user's own effect, from the file that a flown model names: its law is the only shared code."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_sim.compiled import inner
from firmware_sim.layout import ROTOR, Record
from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.effects.law_call import call_law
from groundstation.dynamics.model import Model


def apply_own(p: Any, model: Model) -> None:
    """Put the laws of a model's own effects into a PARAMETERS record."""
    craft = craft_of_model(model)[0]
    p["law"], p["law_values"] = craft["law"], craft["law_values"]


@inner
def own_acceleration(p: Record, y: Any, dy: Any) -> Any:
    """What the laws add: rad/s^2 about the body axes, then m/s^2 along them."""
    state, slope, added = np.empty(17), np.empty(4), np.zeros(6)
    for i in range(17):
        state[i] = y[i]
    for i in range(4):
        slope[i] = dy[ROTOR + i]
    call_law(p.law, p.law_values, state, slope, added)
    return added[0], added[1], added[2], added[3], added[4], added[5]
