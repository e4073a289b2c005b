"""Thrust that falls with the climb speed: -loss w along the body's z.

Source: momentum theory, the inflow of a climbing rotor (Leishman 2.13); w is the body velocity
along z.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import CLIMBS, Confusion, Effect, Parameter
from groundstation.telemetry.packet import STANDARD_GRAVITY


def law(values: Any, craft: Any, body: Any) -> Any:
    """Angular and linear acceleration that it adds."""
    return (0.0, 0.0, 0.0), (0.0, 0.0, -STANDARD_GRAVITY * values[0] * body.velocity[2])


EFFECT = Effect(
    name="climb_inflow",
    stage="body",
    law=law,
    parameters=(
        Parameter("loss_g_per_m_s", "g per m/s", default=0.03, low=0.001, high=0.2, step=1e-3),
    ),
    adds="-loss times the climb speed along the body's z",
    signature="thrust falls while climbing and grows while sinking",
    excited_by=CLIMBS,
    channels=("accelerometer z",),
    regimes=frozenset({"climb", "descent"}),
    needs=("accelerometer", "attitude"),
    unmeasured=("velocity",),
    confused_with=(
        Confusion("supply_sag", f"{CLIMBS}; thrust steps on the spot"),
        Confusion("ground_effect", CLIMBS),
    ),
)
