"""Slow air, or a trim that drifts: a moment and a force that nothing on board explains.

Each of the six is a sum of waves, evenly apart in the logarithm of their frequency, with the power
that noise through a first-order low-pass has there: the same wind at the same time of every flight.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import POSITIVE, Effect, Values, each, zeroes
from firmware_sim.layout import Record

WAVES, SLOWEST, FASTEST = 32, 0.01, 8.0
"""Their number, and turns in one time constant."""
_EDGES = SLOWEST * (FASTEST / SLOWEST) ** (np.arange(WAVES + 1) / WAVES)
_POWER = np.diff(np.arctan(2.0 * np.pi * _EDGES))
TURNS = tuple((2.0 * np.pi * np.sqrt(_EDGES[1:] * _EDGES[:-1])).tolist())
HEIGHTS = tuple(np.sqrt(2.0 * _POWER / _POWER.sum()).tolist())
GOLDEN = math.pi * (math.sqrt(5.0) - 1.0)
"""Phases by the golden ratio are never alike, of no two waves and of no two axes."""
NAMES = (*(f"moment_{axis}" for axis in "xyz"), *(f"force_{axis}" for axis in "xyz"))


@inner
def wind(p: Record, time_s: float, axis: int) -> float:
    """Of roll, pitch, yaw (0-2, rad/s^2) or along the body's x, y, z (3-5, m/s^2)."""
    total = 0.0
    for k in range(WAVES):
        phase = GOLDEN * (WAVES * axis + k) * (k + 1)
        total += HEIGHTS[k] * math.sin(TURNS[k] * time_s / p.wind_time + phase)
    return p.wind[axis] * total


def _apply(p: Any, values: Values) -> None:
    p["wind"] = [values[name] for name in NAMES]
    p["wind_time"] = values["time_s"]
    p["windy"] = int(np.any(p["wind"] != 0.0))


def _present(p: Any) -> Values | None:
    if not p["windy"]:
        return None
    return dict(zip(NAMES, p["wind"].tolist(), strict=True)) | {"time_s": float(p["wind_time"])}


EFFECT = Effect(
    parameters={
        **dict.fromkeys(NAMES[:3], (1.0, "rad/s^2")),
        **dict.fromkeys(NAMES[3:], (0.1, "m/s^2")),
        "time_s": (2.0, "s"),
    },
    apply=_apply,
    clear=zeroes("windy", "wind"),
    present=_present,
    draw=each(
        moment_x=(1.0, 5.0),
        moment_y=(1.0, 5.0),
        moment_z=(0.5, 2.0),
        force_x=(0.1, 0.4),
        force_y=(0.1, 0.4),
        force_z=(0.05, 0.2),
        time_s=(1.0, 5.0),
    ),
    limits={**dict.fromkeys(NAMES, POSITIVE), "time_s": (0.05, math.inf)},
)
