"""The torque that speeds a rotor up turns the craft the other way: +I_r dw/dt on yaw.

w = -n1 + n2 - n3 + n4 in rad/s; dropped in thesis eq. 3.19. The inertia is that of
the gyroscopic torque: where both are found they must agree.
"""

from __future__ import annotations

import math
from typing import Any

from groundstation.dynamics.effect import DOUBLETS, YAW_STEPS, YAWING, Confusion, Effect, Parameter


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    s1, s2, s3, s4 = body.rotor_slope
    yaw = values[0] * 2.0 * math.pi * (-s1 + s2 - s3 + s4) / craft.inertia[2]
    return (0.0, 0.0, yaw), (0.0, 0.0, 0.0)


EFFECT = Effect(
    name="rotor_acceleration_torque",
    stage="body",
    law=law,
    parameters=(
        Parameter(
            "rotor_inertia_kg_m2", "kg m^2", default=5e-8, low=1e-9, high=4e-7, step=1e-8, near=1e-8
        ),
    ),
    adds="+I_r dw/dt on yaw",
    signature="yaw kicks at once when motors change speed, before drag has built up",
    excited_by="sharp yaw steps; roll doublets leave it alone",
    channels=("gyro z",),
    regimes=YAWING | {"rotor acceleration", "rotors slowing down"},
    confused_with=(
        Confusion("yaw_damping", YAW_STEPS),
        Confusion("dead_time", f"{DOUBLETS}: a delay acts on every axis"),
    ),
)
