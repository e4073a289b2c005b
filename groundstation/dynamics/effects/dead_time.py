"""A pure delay between the inputs and everything that is measured: y(t) = y_true(t - delay).

Source: thesis 7.4 (the ARX models' nk); sampling, bus and filters add up to some milliseconds.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter


def law(values: Any) -> float:
    """How late every measurement is, s."""
    delay_s: float = values[0]
    return delay_s


EFFECT = Effect(
    name="dead_time",
    stage="delay",
    law=law,
    parameters=(
        Parameter(
            "delay_s",
            "s",
            default=0.004,
            low=5e-5,
            high=0.04,
            least=0.0,
            bounds=(0.0, 0.045),
            step=2e-4,
            stride=1e-3,
            near=3e-4,
        ),
    ),
    adds="all measured outputs show the past by a pure delay",
    signature="rates, attitude and specific force all answer the motors late by the same time",
    excited_by=effect.DOUBLETS,
    channels=(*effect.GYRO, *effect.FORCE, *effect.ANGLES),
    regimes=effect.TILTING | effect.YAWING | effect.ROTORS | effect.STEADY,
    confused_with=(
        Confusion("gyro_low_pass", f"{effect.DOUBLETS}: a low-pass lags the gyro alone"),
        Confusion("motor_braking_asymmetry", "thrust steps up and down: a delay is the same"),
    ),
)
