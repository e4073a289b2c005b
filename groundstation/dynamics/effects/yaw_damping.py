"""Yaw torque linear in the yaw rate: -d r.

Source: the rotors' drag changes with their speed through the air, n -+ r.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import YAW_STEPS, YAWING, Confusion, Effect, Parameter


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    return (0.0, 0.0, -values[0] * body.rate[2] / craft.inertia[2]), (0.0, 0.0, 0.0)


EFFECT = Effect(
    name="yaw_damping",
    stage="body",
    law=law,
    parameters=(Parameter("damping_n_m_s", "N m s", default=4e-6, low=5e-8, high=1e-4, step=1e-6),),
    adds="-d r on yaw",
    signature="a turn needs torque to be kept up, in proportion to the yaw rate",
    excited_by=YAW_STEPS,
    channels=("gyro z",),
    regimes=YAWING,
    confused_with=(Confusion("rotor_acceleration_torque", YAW_STEPS),),
)
