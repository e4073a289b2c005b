"""A constant added to the gyro, in sensor axes."""

from __future__ import annotations

import math
from typing import Any

from groundstation.dynamics.effect import ANGLES, STEADY, Confusion, Effect, Parameter, Reading


def law(values: Any, craft: Any, body: Any, reading: Any) -> Any:
    """What the sensors show."""
    degree = math.pi / 180.0
    x, y, z = reading.gyro
    shown = (x + degree * values[0], y + degree * values[1], z + degree * values[2])
    return Reading(shown, reading.accelerometer, reading.rotor)


EFFECT = Effect(
    name="gyro_bias",
    stage="sensor",
    law=law,
    order=2,  # in the axes of the sensor
    parameters=tuple(
        Parameter(name, "deg/s", default=0.0, low=-20.0, high=20.0, step=0.1, worth=1.0)
        for name in ("x_dps", "y_dps", "z_dps")
    ),
    negligible=0.16,
    because="the firmware subtracts a whole number of counts from 128 noisy samples as its bias:"
    " up to two, 0.122 deg/s, always lie between the gyro and the attitude",
    adds="a constant added to the gyro",
    signature="the attitude does not turn as the gyro says: a constant rate is left over",
    excited_by="nothing special; attitude must be recorded",
    channels=ANGLES,
    regimes=STEADY,
    needs=("attitude",),
    confused_with=(
        Confusion(
            "attitude_filter_lean",
            "hover still for 10 s, then tilt: a bias drifts always, a lean only when tilted",
        ),
    ),
)
