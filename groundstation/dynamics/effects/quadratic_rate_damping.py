"""Roll and pitch torque in the rate times its magnitude: -d p |p|, -d q |q|.

Source: drag of arms and frame that move through the air.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import TILT_RATES, TILTING, Confusion, Effect, Parameter


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    p, q, _ = body.rate
    return (
        (
            -values[0] * p * abs(p) / craft.inertia[0],
            -values[0] * q * abs(q) / craft.inertia[1],
            0.0,
        ),
        (0.0, 0.0, 0.0),
    )


EFFECT = Effect(
    name="quadratic_rate_damping",
    stage="body",
    law=law,
    parameters=(
        Parameter("damping_n_m_s2", "N m s^2", default=1.5e-5, low=1e-7, high=3e-4, step=1e-6),
    ),
    adds="-d p |p| on roll, -d q |q| on pitch",
    signature="angular acceleration falls short at high rates only",
    excited_by="large roll and pitch doublets, 3 rad/s and more",
    channels=TILT_RATES,
    regimes=TILTING,
    confused_with=(Confusion("rate_damping", "doublets of several sizes, 1 to 6 rad/s"),),
)
