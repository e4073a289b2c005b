"""Thrust that does not act through the centre of gravity: -y T on roll, +x T on pitch.

(x, y) is the centre of gravity seen from the rotors' centre, T the total thrust.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import STEADY, THRUST, TILT_RATES, Confusion, Effect, Parameter


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    x, y = values
    return (
        (-y * body.thrust / craft.inertia[0], x * body.thrust / craft.inertia[1], 0.0),
        (0.0, 0.0, 0.0),
    )


EFFECT = Effect(
    name="centre_of_gravity_offset",
    stage="body",
    law=law,
    parameters=tuple(
        Parameter(
            name,
            "m",
            default=0.0,
            low=-0.008,
            high=0.008,
            bounds=(-0.02, 0.02),
            step=1e-4,
            worth=5e-4,
        )
        for name in ("x_m", "y_m")
    ),
    adds="roll -y T, pitch +x T with the total thrust T; (x, y) is the centre of gravity",
    signature="constant roll or pitch torque that grows with thrust; the controller holds one"
    " motor up",
    excited_by="steps of collective thrust",
    channels=TILT_RATES,
    regimes=STEADY | THRUST,
    confused_with=(
        Confusion(
            "rotor_mismatch",
            "yaw and thrust steps: a weak rotor also changes yaw torque and total thrust",
        ),
    ),
)
