"""Rotors whose angular momenta do not cancel: +I_r q w on roll, -I_r p w on pitch.

w = -n1 + n2 - n3 + n4 in rad/s. M1 and M3 turn counter-clockwise, so the rotors carry h_z = -I_r w;
the signs printed in thesis eq. 3.49-3.56 are misprints (docs/thesis_errata.md). I_r is the inertia
with which accelerating rotors turn the craft, too.
"""

from __future__ import annotations

import math
from typing import Any

from groundstation.dynamics.effect import TILT_RATES, TILTING, YAWING, Confusion, Effect, Parameter

MANOEUVRE = (
    "roll and pitch doublets during a yaw step (rotors apart, no yaw rate yet) and"
    " during a steady turn (yaw rate, rotors together)"
)


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    n1, n2, n3, n4 = body.rotor
    p, q, _ = body.rate
    momentum = values[0] * 2.0 * math.pi * (-n1 + n2 - n3 + n4)
    return (
        (momentum * q / craft.inertia[0], -momentum * p / craft.inertia[1], 0.0),
        (0.0, 0.0, 0.0),
    )


EFFECT = Effect(
    name="rotor_gyroscopic_torque",
    stage="body",
    law=law,
    parameters=(
        Parameter(
            "rotor_inertia_kg_m2",
            "kg m^2",
            default=5e-8,
            low=1e-9,
            high=4e-7,
            step=1e-8,
            near=1e-8,
            shares="rotor_acceleration_torque.rotor_inertia_kg_m2",
        ),
    ),
    adds="+I_r q w on roll and -I_r p w on pitch, w = -n1 + n2 - n3 + n4 in rad/s",
    signature="roll and pitch couple while the craft is commanded to yaw, and not otherwise",
    excited_by="roll and pitch doublets while yaw commands hold the rotors' speeds apart",
    channels=TILT_RATES,
    regimes=YAWING | TILTING,
    confused_with=(Confusion("inertia_coupling", MANOEUVRE),),
)
