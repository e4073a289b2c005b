"""The reported battery voltage follows the real one, first order: T dr/dt = v - r.

Source: the firmware's filter of the converter (docs/stand_in.md). A model is driven by the report,
so the law undoes the lag: v_k = (r_k - e r_(k-1)) / (1 - e) with e = exp(-period/T). The inverse
multiplies the report's resolution by T / period, white noise that the motors, fifty times slower
than a row, average away again; what is left is limited to a quarter of the report around it.
"""

from __future__ import annotations

import math
from typing import Any

from groundstation.dynamics.effect import ROTORS, THRUST, Confusion, Effect, Parameter

MOST_CHANGE = 0.25
"""The voltage behind a report stays within this share of it: a cell sags by less."""


def law(values: Any, craft: Any, supply: Any, supply_mv: float) -> float:
    """The real voltage, mV."""
    keep = math.exp(-supply.period_s / values[0])
    behind = (supply.reported - keep * supply.before) / (1.0 - keep)
    low, high = (1.0 - MOST_CHANGE) * supply.reported, (1.0 + MOST_CHANGE) * supply.reported
    found: float = supply_mv - supply.reported + min(max(behind, low), high)
    return found


EFFECT = Effect(
    name="battery_reading_lag",
    stage="supply",
    law=law,
    parameters=(
        Parameter(
            "time_constant_s",
            "s",
            default=0.155,
            low=0.01,
            high=1.5,
            least=0.0,
            bounds=(0.0, 2.0),
            step=0.03,
            starts=(0.08, 0.25, 0.6),
        ),
    ),
    adds="the reported voltage follows the real one, first order",
    signature="thrust is wrong for a moment after each thrust step, then right again",
    excited_by="fast steps of collective thrust over 60..140 % of hover",
    channels=("accelerometer z",),
    regimes=THRUST | ROTORS,
    needs=("modelled rotors",),
    confused_with=(
        Confusion("supply_sag", "thrust steps held for 2 s: sag stays, lag dies out"),
        Confusion("motor_braking_asymmetry", "thrust steps up and down: a lag is symmetric"),
    ),
)
