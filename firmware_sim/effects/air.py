"""Forces and moments of the air on a craft that moves."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.layout import Record


@inner
def drag_force(p: Record, forward: float, left: float) -> Any:
    """rotor_drag: in-plane force in N against the body velocity (m/s)."""
    return -p.rotor_drag * forward, -p.rotor_drag * left


@inner
def flapping_acceleration(p: Record, forward: float, left: float) -> Any:
    """velocity_moment in rad/s^2: the rotors tip back against the motion (blade flapping)."""
    return p.velocity_moment * left, -p.velocity_moment * forward


@inner
def inflow_loss(p: Record, climb: float) -> float:
    """climb_inflow in m/s^2: thrust lost with the climb speed along the body's z (m/s)."""
    loss: float = -p.climb_inflow * climb
    return loss


@inner
def ground_factor(p: Record, height: float) -> float:
    """ground_effect: thrust near the ground relative to thrust far from it."""
    return 1.0 + p.ground_gain * math.exp(-max(height, 0.0) / p.ground_height)
