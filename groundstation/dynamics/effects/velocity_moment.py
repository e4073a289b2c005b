"""Roll and pitch moment proportional to the body velocity: roll +c (1 - e) v, pitch -c (1 + e) u.

Source: blade flapping tips the rotors back against the motion (Pounds, Mahony and Corke, 2010).
(u, v) is the body velocity forward and left. Drag in the rotors' plane adds to it above the centre
of gravity and takes from it below: with a centre of gravity above that plane the sign can turn. No
frame, deck or battery stands alike in both winds, nor are both inertias the same: c is the mean of
both axes, e their ``asymmetry``.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    forward, left, _ = body.velocity
    moment, asymmetry = values
    return (
        (moment * (1.0 - asymmetry) * left, -moment * (1.0 + asymmetry) * forward, 0.0),
        (0.0, 0.0, 0.0),
    )


EFFECT = Effect(
    name="velocity_moment",
    stage="body",
    law=law,
    parameters=(
        Parameter("moment", "rad/s^2 per m/s", default=10.0, low=-80.0, high=80.0, step=1.0),
        Parameter(
            "asymmetry",
            "",
            default=0.0,
            low=-0.8,
            high=0.8,
            kind="shape",
            bounds=(-0.95, 0.95),
            step=0.01,
            stride=0.3,
            worth=0.2,
        ),
    ),
    adds="roll +c (1 - e) v, pitch -c (1 + e) u, (u, v) the body velocity forward and left",
    signature="the craft rears up against its motion: torque in proportion to speed",
    excited_by=effect.TRANSLATE,
    channels=effect.TILT_RATES,
    regimes=effect.TRANSLATION,
    needs=("accelerometer", "attitude"),
    unmeasured=("velocity",),
    confused_with=(
        Confusion("rate_damping", f"{effect.HOVER_DOUBLETS}; {effect.TRANSLATE}"),
        Confusion("centre_of_gravity_offset", "flight to and fro: an offset keeps its sign"),
    ),
)
