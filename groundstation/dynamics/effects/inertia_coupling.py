"""-Omega x (I Omega): (Iyy-Izz) q r on roll, (Izz-Ixx) p r on pitch, (Ixx-Iyy) p q on yaw.

Source: thesis eq. 3.51-3.53. A fraction of 1 is the rigid body's own.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import GYRO, TILTING, YAWING, Confusion, Effect, Parameter


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    ixx, iyy, izz = craft.inertia
    p, q, r = body.rate
    share = values[0]
    return (
        (
            share * (iyy - izz) * q * r / ixx,
            share * (izz - ixx) * p * r / iyy,
            share * (ixx - iyy) * p * q / izz,
        ),
        (0.0, 0.0, 0.0),
    )


EFFECT = Effect(
    name="inertia_coupling",
    stage="body",
    law=law,
    parameters=(Parameter("fraction", "", default=1.0, low=0.1, high=2.0, step=0.1),),
    adds="(Iyy-Izz) q r on roll, (Izz-Ixx) p r on pitch, (Ixx-Iyy) p q on yaw",
    signature="roll and pitch couple in proportion to the yaw rate",
    excited_by="roll and pitch doublets during a steady fast turn",
    channels=GYRO,
    regimes=YAWING | TILTING,
    confused_with=(
        Confusion(
            "rotor_gyroscopic_torque",
            "roll and pitch doublets during a steady turn: the rotors are then together",
        ),
        Confusion("imu_misalignment", "roll and pitch doublets without any yaw rate"),
    ),
)
