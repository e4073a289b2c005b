"""Roll and pitch torque linear in the body rate: -d p, -d q.

Source: the rotors' inflow changes as an arm moves up or down (Leishman, Principles of Helicopter
Aerodynamics, 4.7).
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    p, q, _ = body.rate
    return (
        (-values[0] * p / craft.inertia[0], -values[0] * q / craft.inertia[1], 0.0),
        (0.0, 0.0, 0.0),
    )


EFFECT = Effect(
    name="rate_damping",
    stage="body",
    law=law,
    parameters=(Parameter("damping_n_m_s", "N m s", default=1e-5, low=1e-7, high=2e-4, step=1e-6),),
    adds="-d p on roll, -d q on pitch",
    signature="angular acceleration falls short in proportion to the rate, alike on roll and pitch",
    excited_by=effect.HOVER_DOUBLETS,
    channels=effect.TILT_RATES,
    regimes=effect.TILTING,
    confused_with=(
        Confusion("quadratic_rate_damping", "doublets of several sizes, 1 to 6 rad/s"),
        Confusion("velocity_moment", f"{effect.HOVER_DOUBLETS}; {effect.TRANSLATE}"),
    ),
)
