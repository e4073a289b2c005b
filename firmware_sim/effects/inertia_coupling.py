"""-Omega x (I Omega), thesis eq. 3.51-3.53."""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, fixed, reads, sets
from firmware_sim.layout import Record


@inner
def coupling_torque(p: Record, roll_rate: float, pitch_rate: float, yaw_rate: float) -> Any:
    """Torque in N m, times the share ``coupling``."""
    ixx, iyy, izz = p.inertia[0], p.inertia[1], p.inertia[2]
    return (
        p.coupling * (iyy - izz) * pitch_rate * yaw_rate,
        p.coupling * (izz - ixx) * roll_rate * yaw_rate,
        p.coupling * (ixx - iyy) * roll_rate * pitch_rate,
    )


EFFECT = Effect(
    parameters={"fraction": (1.0, "")},
    apply=sets(coupling="fraction"),
    present=reads(coupling="fraction"),
    draw=fixed(fraction=1.0),
)
