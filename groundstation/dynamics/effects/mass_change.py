"""Another mass than the model's: every specific force is divided by 1 + percent / 100.

Source: Newton's second law. A payload, another battery, or rotors that give less thrust than when
the model was fitted, which no telemetry tells apart; torques over inertia (c0, c1, c2) stay.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter, Rename


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    lost = values[0] / (100.0 + values[0])
    x, y, z = body.force
    return (0.0, 0.0, 0.0), (-lost * x, -lost * y, -lost * z)


def _lifted(given: float, percent: float) -> float:
    """Thrust per mass of the heavier craft."""
    return given / (1.0 + percent / 100.0)


EFFECT = Effect(
    name="mass_change",
    stage="body",
    law=law,
    order=9,  # of all forces that there are
    parameters=(
        Parameter(
            "percent",
            "%",
            default=10.0,
            low=-50.0,
            high=150.0,
            least=-90.0,
            bounds=(-60.0, 300.0),
            step=0.5,
        ),
    ),
    renames=Rename("thrust_per_mass", _lifted),
    negligible=3.0,
    because="rotors and batteries of one craft differ by so much from flight to flight",
    needs=("accelerometer",),
    adds="specific force over 1 + percent / 100: the craft is heavier or lighter than the model",
    signature="the craft hovers at another rotor speed than the model, at any voltage",
    excited_by="nothing special; weigh the craft",
    channels=effect.FORCE,
    regimes=effect.STEADY | effect.THRUST,
    confused_with=(
        Confusion("supply_sag", "hover with a full and with an empty battery: a mass is the same"),
        Confusion("motor_dead_voltage", "steps of collective thrust: a mass scales, a loss shifts"),
        Confusion("accelerometer_bias", "steps of collective thrust: a bias does not grow with it"),
    ),
)
