"""In-plane force proportional to the body velocity: -d u, -d v.

Source: blade flapping and induced drag of the rotors (Martin and Salaun, The true role of
accelerometer feedback in quadrotor control, 2010); seen by the accelerometer.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    forward, left, _ = body.velocity
    drag = values[0] / craft.mass
    return (0.0, 0.0, 0.0), (-drag * forward, -drag * left, 0.0)


EFFECT = Effect(
    name="rotor_drag",
    stage="body",
    law=law,
    parameters=(Parameter("drag_n_s_m", "N s/m", default=0.008, low=3e-4, high=0.06, step=1e-3),),
    adds="in-plane force -d times the body velocity",
    signature="specific force in the plane against the velocity",
    excited_by=effect.TRANSLATE,
    channels=("accelerometer x", "accelerometer y"),
    regimes=effect.TRANSLATION,
    needs=("accelerometer", "attitude"),
    unmeasured=("velocity",),
    confused_with=(
        Confusion("accelerometer_bias", effect.TRANSLATE),
        Confusion("imu_lever_arm", f"{effect.HOVER_DOUBLETS}; {effect.TRANSLATE}"),
    ),
)
