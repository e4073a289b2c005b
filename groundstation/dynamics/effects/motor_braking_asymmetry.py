"""Motors that slow down more slowly than they speed up: a negative dn/dt times a factor.

Source: one switch per motor drives current in one direction only; it cannot brake.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import GYRO, ROTORS, TILTING, Confusion, Effect, Parameter


def law(values: Any, motor: Any, slope: float) -> float:
    """dn/dt of a motor that brakes by its own."""
    found: float = slope * values[0] if slope < 0.0 else slope
    return found


EFFECT = Effect(
    name="motor_braking_asymmetry",
    stage="motor",
    law=law,
    order=2,  # of the slope that the current leaves
    parameters=(
        Parameter(
            "factor",
            "",
            default=0.6,
            low=0.1,
            high=2.0,
            absent=1.0,
            bounds=(0.05, 3.0),
            step=0.02,
            stride=0.2,
            worth=0.4,
        ),
    ),
    adds="a negative dn/dt times the factor",
    signature="thrust falls more slowly than it rises; torques lag on the motor that slows down",
    excited_by="fast thrust steps down and up, sharp doublets on all axes",
    channels=("accelerometer z", *GYRO),
    regimes=ROTORS | TILTING | {"after yaw commands", "low thrust"},
    needs=("modelled rotors",),
    confused_with=(
        Confusion("dead_time", "thrust steps up and down: a delay is the same both ways"),
    ),
)
