"""Sensor axes turned Rz Ry Rx in the body; the angles are the sensor's."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_sim.effects.effect import Effect, Values, vector

NAMES = ("roll_deg", "pitch_deg", "yaw_deg")


def _apply(p: Any, values: Values) -> None:
    roll, pitch, yaw = (math.radians(values[name]) for name in NAMES)
    if not (roll or pitch or yaw):
        return
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    p["mounting"] = (about_z @ about_y @ about_x).ravel()
    p["rotated"] = 1


def _present(p: Any) -> Values | None:
    if not p["rotated"]:
        return None
    m = p["mounting"].reshape(3, 3)
    return {
        "roll_deg": math.degrees(math.atan2(m[2, 1], m[2, 2])),
        "pitch_deg": math.degrees(-math.asin(m[2, 0])),
        "yaw_deg": math.degrees(math.atan2(m[1, 0], m[0, 0])),
    }


EFFECT = Effect(
    parameters=dict.fromkeys(NAMES, (0.0, "deg")),
    apply=_apply,
    present=_present,
    draw=vector(0.5, 7.0, *NAMES),
    hidden=3,
)
