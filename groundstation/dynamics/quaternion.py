"""Rotations inside kernels: unit quaternions (w, x, y, z), body to inertial, as tuples.

For arrays, and for the conventions, see ``rotations.py``; ``to_inertial`` and ``to_body`` are those
of ``law.py``.
"""

from __future__ import annotations

import math
from typing import Any

from groundstation.compiled import inner
from groundstation.dynamics import law

to_inertial = inner(law.to_inertial)


@inner
def conjugate(q: Any) -> Any:
    """The rotation back."""
    return q[0], -q[1], -q[2], -q[3]


@inner
def to_body(q: Any, v: Any) -> Any:
    """An inertial vector in body axes."""
    return to_inertial((q[0], -q[1], -q[2], -q[3]), v)


@inner
def product(a: Any, b: Any) -> Any:
    """The rotation b, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@inner
def normalised(q: Any) -> Any:
    """The same rotation with length 1."""
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale


@inner
def slope(q: Any, rate: Any) -> Any:
    """dq/dt at body rates in rad/s."""
    w, x, y, z = q
    a, b, c = rate
    return (
        0.5 * (-x * a - y * b - z * c),
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a),
    )


@inner
def angles(q: Any) -> Any:
    """Roll, pitch (nose down positive), yaw in rad (thesis eq. 3.6)."""
    w, x, y, z = q
    return (
        math.atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(min(max(2.0 * (w * y - x * z), -1.0), 1.0)),
        math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)),
    )


@inner
def of_angles(attitude: Any) -> Any:
    """The quaternion of roll, pitch, yaw in rad."""
    cr, sr = math.cos(0.5 * attitude[0]), math.sin(0.5 * attitude[0])
    cp, sp = math.cos(0.5 * attitude[1]), math.sin(0.5 * attitude[1])
    cy, sy = math.cos(0.5 * attitude[2]), math.sin(0.5 * attitude[2])
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
