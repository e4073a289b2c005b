"""The sensor behind recorded rotor speeds lags: d shown/dt = (speed - shown) / lag.

A deck that times blade passages averages over revolutions, and a log holds its last reading. What
turns the craft is earlier than what is recorded. Rows that show speeds are always fitted with it,
for left out it bends the constants; PWM and what rates show of the torque tell it.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import Effect, Parameter


def law(values: Any) -> Any:
    """Time constant, s."""
    return values[0]


EFFECT = Effect(
    name="rotor_speed_sensor",
    stage="tachometer",
    law=law,
    parameters=(
        Parameter(
            "lag_s",
            "s",
            default=0.005,
            low=2e-4,
            high=0.02,
            least=0.0,
            bounds=(0.0, 0.02),
            step=1e-3,
        ),
    ),
    adds="recorded rotor speeds follow the true ones, first order",
    signature="the craft answers before the recorded rotors do",
    excited_by="sharp doublets on all axes, rotor speeds recorded",
    channels=("gyro x", "gyro y", "gyro z", "accelerometer z"),
)
