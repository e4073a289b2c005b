"""A constant added to the accelerometer, in sensor axes."""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter, Reading
from groundstation.telemetry.packet import STANDARD_GRAVITY


def law(values: Any, craft: Any, body: Any, reading: Any) -> Any:
    """What the sensors show."""
    x, y, z = reading.accelerometer
    shown = (
        x + STANDARD_GRAVITY * values[0],
        y + STANDARD_GRAVITY * values[1],
        z + STANDARD_GRAVITY * values[2],
    )
    return Reading(reading.gyro, shown, reading.rotor)


EFFECT = Effect(
    name="accelerometer_bias",
    stage="sensor",
    law=law,
    order=2,  # in the axes of the sensor
    parameters=tuple(
        Parameter(name, "g", default=0.0, low=-0.3, high=0.3, step=1e-3, worth=0.03)
        for name in ("x_g", "y_g", "z_g")
    ),
    adds="a constant added to the accelerometer",
    signature="specific force is off by the same amount at any thrust and speed",
    excited_by="start and end at rest; steps of collective thrust",
    channels=effect.FORCE,
    regimes=effect.STEADY,
    negligible=0.003,
    because="the velocity that is integrated from it is known to some cm/s: an offset of a sixth of"
    " a degree of tilt is what the rates make of that",
    needs=("accelerometer",),
    confused_with=(
        Confusion("imu_misalignment", "thrust steps: a tilt of the sensor grows with thrust"),
        Confusion("rotor_drag", effect.TRANSLATE),
    ),
)
