"""A craft that turns by the ARX polynomials of a fitted model (thesis eq. 7.32-7.34).

In the air the polynomials give roll, pitch and yaw from the mixer's u', a pass at a time and with
their delay; rotors, thrust and the way through space stay the plant's. On the ground, and where the
craft has tumbled, the rigid body turns.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_sim.compiled import inner
from firmware_sim.effects.motor_dead_voltage import armature_mv
from firmware_sim.layout import (
    ARX_DEPTH,
    ARX_ORDER,
    FREE,
    PASS_NS,
    QUATERNION,
    RATE,
    ROTOR,
    Record,
)
from firmware_sim.pilot import LANDED_M
from firmware_sim.plant import rotor_acceleration
from groundstation.dynamics.arx import AXES, angle_polynomial
from groundstation.dynamics.arx_period import at_period
from groundstation.dynamics.mixer import MIXERS
from groundstation.dynamics.model import Model, model_vehicle

PASS_S = PASS_NS * 1e-9
TUMBLED_RAD = 1.4
TURNING = (
    *("dead_time", "gyro_low_pass", "inertia_coupling", "rotor_gyroscopic_torque"),
    *("rotor_acceleration_torque", "rate_damping", "quadratic_rate_damping", "yaw_damping"),
    *("centre_of_gravity_offset", "velocity_moment"),
)
"""Effects that are in the polynomials already: how the craft turns, and how late that is seen."""


def put_polynomials(p: Any, model: Model) -> None:
    """Let the polynomials of a model turn the craft of a PARAMETERS record.

    Raises ValueError for polynomials that the loop cannot step.
    """
    model = at_period(model, PASS_S)
    for i, name in enumerate(AXES):
        one = angle_polynomial(model, name)
        if max(one.na, one.nb) > ARX_ORDER or one.nk + one.nb > ARX_DEPTH:
            raise ValueError(
                f"the ARX polynomials of {name} look back {one.na} and {one.nk + one.nb} rows, at"
                f" most {ARX_ORDER} and {ARX_DEPTH} can be flown"
            )
        p["arx_order"][i] = one.na, one.nb, one.nk
        p["arx_a"][i, : one.na], p["arx_b"][i, : one.nb] = one.a, one.b
    p["arx_mixer"] = np.asarray(MIXERS[model_vehicle(model).configuration])
    p["arx_turns"] = 1


@inner
def turn(p: Record, s: Record) -> None:
    """Attitude and rates of the pass that begins, by the polynomials where the craft flies."""
    _remember_inputs(p, s)
    flies = s.mode == FREE and s.y[2] >= LANDED_M
    flies = flies and max(abs(s.arx_angles[0, 0]), abs(s.arx_angles[0, 1])) < TUMBLED_RAD
    if not flies:
        s.arx_flying = 0
        for k in range(ARX_ORDER - 1, 0, -1):
            for i in range(3):
                s.arx_angles[k, i] = s.arx_angles[k - 1, i]
        _angles_of_body(s)
        return
    s.arx_flying = 1
    a0, a1, a2 = _next(p, s, 0), _next(p, s, 1), _next(p, s, 2)
    half = 0.5 / PASS_S
    droll = half * (a0 - s.arx_angles[1, 0])
    dpitch = half * (a1 - s.arx_angles[1, 1])
    dyaw = half * (a2 - s.arx_angles[1, 2])
    _show(s, droll, dpitch, dyaw)
    for k in range(ARX_ORDER - 1, 0, -1):
        for i in range(3):
            s.arx_angles[k, i] = s.arx_angles[k - 1, i]
    s.arx_angles[0, 0], s.arx_angles[0, 1], s.arx_angles[0, 2] = a0, a1, a2


@inner
def _next(p: Record, s: Record, axis: int) -> float:
    """The angle at the end of the pass; torque noise is the equation's error (7.9)."""
    na, nb, nk = p.arx_order[axis, 0], p.arx_order[axis, 1], p.arx_order[axis, 2]
    value = s.noise[axis] * PASS_S * PASS_S
    for j in range(nb):
        value += p.arx_b[axis, j] * s.arx_inputs[nk + j, axis]
    for i in range(na):
        value -= p.arx_a[axis, i] * s.arx_angles[i, axis]
    return float(value)


@inner
def _remember_inputs(p: Record, s: Record) -> None:
    """u' (7.19) as a mean over the pass that begins: the rotors do not depend on the body."""
    for k in range(ARX_DEPTH - 1, 0, -1):
        for i in range(3):
            s.arx_inputs[k, i] = s.arx_inputs[k - 1, i]
    for i in range(3):
        s.arx_inputs[0, i] = 0.0
    for rotor in range(4):
        speed = s.y[ROTOR + rotor]
        volts = armature_mv(p, s.duty[rotor] * s.supply_mv)
        first = rotor_acceleration(p, rotor, volts, speed)
        last = rotor_acceleration(p, rotor, volts, max(speed + PASS_S * first, 0.0))
        end = max(speed + 0.5 * PASS_S * (first + last), 0.0)
        square = (speed * speed + speed * end + end * end) / 3.0
        for i in range(3):
            s.arx_inputs[0, i] += p.arx_mixer[i, rotor] * square


@inner
def _angles_of_body(s: Record) -> None:
    w, x, y, z = s.y[QUATERNION], s.y[7], s.y[8], s.y[9]
    s.arx_angles[0, 0] = math.atan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    s.arx_angles[0, 1] = math.asin(min(max(2 * (w * y - x * z), -1.0), 1.0))
    s.arx_angles[0, 2] = math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))


@inner
def _show(s: Record, droll: float, dpitch: float, dyaw: float) -> None:
    """Quaternion and body rates (3.9) of the present angles and their slopes."""
    roll, pitch, yaw = s.arx_angles[0, 0], s.arx_angles[0, 1], s.arx_angles[0, 2]
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    s.y[QUATERNION] = cr * cp * cy + sr * sp * sy
    s.y[7] = sr * cp * cy - cr * sp * sy
    s.y[8] = cr * sp * cy + sr * cp * sy
    s.y[9] = cr * cp * sy - sr * sp * cy
    s.y[RATE] = droll - math.sin(pitch) * dyaw
    s.y[11] = math.cos(roll) * dpitch + math.cos(pitch) * math.sin(roll) * dyaw
    s.y[12] = -math.sin(roll) * dpitch + math.cos(pitch) * math.cos(roll) * dyaw
