"""A sensor that is rotated in the frame: it shows M^T of what the body does, M = Rz Ry Rx.

The angles that a firmware reports are the sensor's. Source: thesis eq. 3.6 for the rotation.
"""

from __future__ import annotations

import math
from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter, Reading


def law(values: Any, craft: Any, body: Any, reading: Any) -> Any:
    """What the sensors show."""
    degree = math.pi / 180.0
    cr, sr = math.cos(degree * values[0]), math.sin(degree * values[0])
    cp, sp = math.cos(degree * values[1]), math.sin(degree * values[1])
    cy, sy = math.cos(degree * values[2]), math.sin(degree * values[2])
    p, q, r = reading.gyro
    x, y, z = reading.accelerometer
    m11, m12, m13 = cp * cy, cy * sp * sr - cr * sy, cr * cy * sp + sr * sy
    m21, m22, m23 = cp * sy, cr * cy + sp * sr * sy, cr * sp * sy - cy * sr
    m31, m32, m33 = -sp, cp * sr, cp * cr
    return Reading(
        (m11 * p + m21 * q + m31 * r, m12 * p + m22 * q + m32 * r, m13 * p + m23 * q + m33 * r),
        (m11 * x + m21 * y + m31 * z, m12 * x + m22 * y + m32 * z, m13 * x + m23 * y + m33 * z),
        reading.rotor,
    )


def _angle(name: str) -> Parameter:
    return Parameter(
        name,
        "deg",
        default=0.0,
        low=-20.0,
        high=20.0,
        bounds=(-30.0, 30.0),
        step=0.5,
        stride=5.0,
        worth=2.0,
    )


EFFECT = Effect(
    name="imu_misalignment",
    stage="sensor",
    law=law,
    order=1,
    parameters=(_angle("roll_deg"), _angle("pitch_deg"), _angle("yaw_deg")),
    adds="sensor axes turned Rz Ry Rx in the body; gyro, accelerometer and angles are the sensor's",
    signature="motion about one axis shows on another; thrust has a part in the sensor's plane",
    excited_by="doublets of one axis at a time, yaw steps, thrust steps",
    channels=(*effect.GYRO, "accelerometer x", "accelerometer y"),
    regimes=effect.STEADY | effect.TILTING | effect.YAWING | effect.THRUST,
    confused_with=(
        Confusion("accelerometer_bias", "thrust steps: a bias stays the same"),
        Confusion("inertia_coupling", "roll and pitch doublets without any yaw rate"),
    ),
)
