"""An IMU away from the centre of gravity: alpha x r + Omega x (Omega x r) in the accelerometer.

Source: acceleration of a point of a rigid body; all in body axes, r from the centre to the sensor.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter, Reading


def law(values: Any, craft: Any, body: Any, reading: Any) -> Any:
    """What the sensors show."""
    x, y, z = values
    p, q, r = body.rate
    ap, aq, ar = body.angular
    fx, fy, fz = reading.accelerometer
    along = p * x + q * y + r * z
    square = p * p + q * q + r * r
    felt = (
        fx + aq * z - ar * y + p * along - square * x,
        fy + ar * x - ap * z + q * along - square * y,
        fz + ap * y - aq * x + r * along - square * z,
    )
    return Reading(reading.gyro, felt, reading.rotor)


EFFECT = Effect(
    name="imu_lever_arm",
    stage="sensor",
    law=law,
    parameters=tuple(
        Parameter(name, "m", default=0.0, low=-0.03, high=0.03, step=1e-3, worth=0.003)
        for name in ("x_m", "y_m", "z_m")
    ),
    adds="alpha x r + Omega x (Omega x r) in the accelerometer",
    signature="the accelerometer answers angular acceleration at once",
    excited_by="sharp doublets on all axes, a steady fast turn",
    channels=effect.FORCE,
    regimes=effect.TILTING | effect.YAWING | {"rotor acceleration"},
    needs=("accelerometer",),
    negligible=5e-4,
    because="less than a battery moves the centre of gravity by when it is put back",
    confused_with=(Confusion("rotor_drag", f"{effect.HOVER_DOUBLETS}; {effect.TRANSLATE}"),),
)
