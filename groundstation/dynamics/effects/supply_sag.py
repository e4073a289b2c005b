"""Resistance between the reported battery voltage and the motors.

V = V_reported - R sum d (d V - k_e n) / R_w, solved for V: each motor draws its duty d times
(u - k_e n) / R_w (thesis eq. 3.78), with k_e = a1/a0 as upper bound of the back-EMF constant.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter


def law(values: Any, craft: Any, supply: Any, supply_mv: float) -> float:
    """What is left at the motors, mV."""
    d1, d2, d3, d4 = supply.duty
    n1, n2, n3, n4 = supply.rotor
    k1, k2, k3, k4 = craft.back_emf_mv
    share = values[0] / craft.winding_ohm
    emf = d1 * k1 * n1 + d2 * k2 * n2 + d3 * k3 * n3 + d4 * k4 * n4
    squares = d1 * d1 + d2 * d2 + d3 * d3 + d4 * d4
    found: float = (supply_mv + share * emf) / (1.0 + share * squares)
    return found


EFFECT = Effect(
    name="supply_sag",
    stage="supply",
    law=law,
    order=1,  # of the true voltage, behind a report that lags
    parameters=(
        Parameter(
            "resistance_ohm",
            "ohm",
            default=0.15,
            low=0.003,
            high=1.0,
            bounds=(-0.3, 1.5),
            step=0.005,
        ),
    ),
    adds="motors get the reported voltage less R times their summed supply current, duty"
    " (u - k_e n)/R_w each",
    signature="all four motors give less when any of them works hard",
    excited_by=effect.THRUST_STEPS,
    channels=("accelerometer z", *effect.TILT_RATES),
    regimes=effect.STEADY | effect.THRUST | effect.ROTORS | {"saturation", "low battery"},
    needs=("modelled rotors",),
    confused_with=(
        Confusion("motor_dead_voltage", effect.THRUST_STEPS),
        Confusion("battery_reading_lag", "thrust steps held for 2 s: a lag dies out"),
    ),
)
