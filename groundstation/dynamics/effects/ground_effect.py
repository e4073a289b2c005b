"""Extra thrust close to the ground: thrust times 1 + gain exp(-z / height).

Source: Cheeseman and Bennett, 1955, with the exponential that small craft follow (Danjun et al.,
2015). A small craft's ground effect reaches about as high as the craft is wide, and is tenths of
the thrust at the ground: what is weak and reaches far is something else.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from groundstation.dynamics.effect import CLIMBS, Confusion, Effect, Parameter

HEIGHT_DOUBT_M, REACH_DOUBT_M = 0.03, 0.02
"""No sensor measures height: what is reckoned is off by a few cm after a low hover, as a shift
(which the gain takes) and as a stretch (which the reach takes)."""


def law(values: Any, craft: Any, body: Any, wrench: Any) -> Any:
    """Thrust and torques with the cushion under the rotors; their drag stays."""
    thrust, roll, pitch, yaw = wrench
    near = 1.0 + values[1] * np.exp(-np.maximum(body.height, 0.0) / values[0])
    return thrust * near, roll * near, pitch * near, yaw


def _doubt(values: Mapping[str, float]) -> dict[str, float]:
    reach = max(values["height_m"], HEIGHT_DOUBT_M)
    return {"height_m": REACH_DOUBT_M, "gain": values["gain"] * HEIGHT_DOUBT_M / reach}


EFFECT = Effect(
    name="ground_effect",
    stage="rotor",
    law=law,
    order=1,  # on the thrust that each rotor has
    parameters=(
        Parameter(
            "height_m",
            "m",
            default=0.08,
            low=0.005,
            high=0.17,
            absent=0.08,
            kind="shape",
            least=1e-3,
            bounds=(0.01, 0.4),
            step=0.005,
        ),
        Parameter("gain", "", default=0.25, low=0.10, high=1.0, step=0.01),
    ),
    doubt=_doubt,
    adds="thrust times 1 + gain exp(-z / height)",
    signature="thrust is too low in the model right after take-off and before landing",
    excited_by="take-off and landing inside the recording, low hover; height counts from the"
    " take-off",
    channels=("accelerometer z",),
    regimes=frozenset({"near ground"}),
    needs=("accelerometer",),
    unmeasured=("height",),
    confused_with=(
        Confusion("climb_inflow", CLIMBS),
        Confusion("battery_reading_lag", "fast thrust steps high above the ground"),
    ),
)
