"""Torques of the rigid body that the base model leaves out."""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.layout import Record


@inner
def coupling_torque(p: Record, roll_rate: float, pitch_rate: float, yaw_rate: float) -> Any:
    """inertia_coupling: -Omega x (I Omega), thesis eq. 3.51-3.53, in N m, times ``coupling``."""
    ixx, iyy, izz = p.inertia[0], p.inertia[1], p.inertia[2]
    return (
        p.coupling * (iyy - izz) * pitch_rate * yaw_rate,
        p.coupling * (izz - ixx) * roll_rate * yaw_rate,
        p.coupling * (ixx - iyy) * roll_rate * pitch_rate,
    )


@inner
def damping_torque(p: Record, rate: float) -> float:
    """rate_damping and quadratic_rate_damping on roll or pitch, N m."""
    torque: float = -(p.rate_damping + p.quadratic_damping * abs(rate)) * rate
    return torque


@inner
def gravity_offset_torque(p: Record, thrust: float) -> Any:
    """centre_of_gravity_offset: the thrust's lever about a centre at (gravity_x, gravity_y)."""
    return -p.gravity_y * thrust, p.gravity_x * thrust
