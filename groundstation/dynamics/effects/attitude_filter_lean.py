"""Reported angles of a Mahony filter at the firmware's gains: 1 is full, 0 the truth.

Source: Mahony, Hamel and Pflimlin, 2008, as the Crazyflie firmware has it
(``dynamics/sensing.py``): the estimate leans towards what the accelerometer feels.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import STEADY, TRANSLATION, Confusion, Effect, Parameter

PROPORTIONAL, INTEGRAL = 0.4, 0.001
"""Half of the firmware's twoKp and twoKi, 1/s and 1/s^2."""


def law(values: Any) -> Any:
    """Gains of the filter, 1/s and 1/s^2."""
    return values[0] * PROPORTIONAL, values[0] * INTEGRAL


EFFECT = Effect(
    name="attitude_filter_lean",
    stage="attitude",
    law=law,
    parameters=(
        Parameter(
            "strength", "", default=1.0, low=0.05, high=1.5, bounds=(-1.5, 1.5), step=0.05, near=0.1
        ),
    ),
    adds="reported angles are a Mahony filter's at the firmware's gains: 1 is full, 0 the truth",
    signature="reported tilt creeps to level within some 2.5 s while the craft accelerates"
    " sideways",
    excited_by="long steady tilts of 10 deg and more, attitude recorded",
    channels=("roll", "pitch"),
    regimes=STEADY | TRANSLATION,
    needs=("accelerometer", "attitude"),
    confused_with=(
        Confusion(
            "gyro_bias",
            "hover still for 10 s, then tilt: a bias drifts always, a lean only when tilted",
        ),
    ),
)
