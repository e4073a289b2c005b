"""Voltage lost before a motor turns: u becomes max(u - voltage, 0) in thesis eq. 3.82.

Source: friction of brushes and bearings, and the drop of the driver's transistor.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter


def law(values: Any, motor: Any, slope: float) -> float:
    """dn/dt without what the lost voltage would have given."""
    left = max(motor.armature_mv - values[0], 0.0)
    found: float = slope + motor.a0 * (left - motor.armature_mv)
    return found


EFFECT = Effect(
    name="motor_dead_voltage",
    stage="motor",
    law=law,
    parameters=(
        Parameter(
            "voltage_mv",
            "mV",
            default=200.0,
            low=10.0,
            high=800.0,
            bounds=(-300.0, 1200.0),
            step=5.0,
            stride=200.0,
        ),
    ),
    adds="a motor turns with u - voltage, not less than 0",
    signature="thrust is too high in the model at low throttle and right at the speed it was"
    " fitted at",
    excited_by=effect.THRUST_STEPS,
    channels=("accelerometer z", *effect.TILT_RATES),
    regimes=effect.STEADY | effect.THRUST | effect.ROTORS | {"saturation", "low battery"},
    needs=("modelled rotors",),
    confused_with=(
        Confusion("supply_sag", effect.THRUST_STEPS),
        Confusion("battery_reading_lag", "thrust steps held for 2 s: a lag dies out"),
    ),
)
