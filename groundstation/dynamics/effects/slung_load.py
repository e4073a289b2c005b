"""A load that swings on a line below the craft: what it does beside being carried.

With r the load's mass over the bare craft's, f the specific force as it would be were the load
fixed to the craft, e the line's direction and f' the part of f across it (inertial axes):

    L e'' = -(1 + r) f' - L |e'|^2 e - damping L e',   force + r f' + r / (1 + r) L |e'|^2 e

A spherical pendulum of any angle on a line that stays taut, hung from a craft that is free to move
(Sreenath, Lee and Kumar, Geometric control of a quadrotor with a cable-suspended load, 2013). Its
weight is not in it: that is in the thrust per mass, as any payload's (``mass_change``), and
``percent`` is its share of the whole. Near the ground the line hangs loose: the load lies there and
is dragged along, and the craft, lighter by it, has r more of its force. The line is tied
``below_m`` under the centre of gravity, where its pull is a moment as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter, State, to_body, to_inertial
from groundstation.telemetry.packet import STANDARD_GRAVITY

DRAG_PER_S = 10.0
"""How fast a load that lies on the ground comes to below the craft: without a swing."""
SWING, SWING_PER_S = 0.002, 0.02
"""How far off its law the line's direction (rad) and slope (rad/s) are: nobody saw how a recorded
swing began."""
LENGTHS_M = tuple(0.1 * 1.15**i for i in range(21))
"""A swing that dies out within seconds hardly answers to one a tenth longer."""


def law(values: Any, craft: Any, body: Any, state: Any) -> Any:
    """Angular and linear acceleration that it adds, and the slopes of the line's direction and of
    its slope, inertial axes."""
    percent, length, damping, below = values
    ratio = percent / (100.0 - percent)
    x, y, z, u, v, w = state
    size = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / size, y / size, z / size
    out = u * x + v * y + w * z
    u, v, w = u - out * x, v - out * y, w - out * z
    turn = u * u + v * v + w * w
    f, g, h = to_inertial(body.quaternion, body.force)
    along = f * x + g * y + h * z
    f, g, h = f - along * x, g - along * y, h - along * z
    # Tight from its own length above the ground on, loose below half of it.
    tight = min(max(2.0 * body.height / length - 1.0, 0.0), 1.0)
    inward = tight * 0.01 * percent * length * turn + (1.0 - tight) * ratio * along
    push = to_body(
        body.quaternion, (ratio * f + inward * x, ratio * g + inward * y, ratio * h + inward * z)
    )
    drive, drag = tight * (1.0 + ratio) / length, (1.0 - tight) * DRAG_PER_S
    slowed = tight * damping + 2.0 * drag
    aside = drag * DRAG_PER_S
    sunk = (x * x + y * y) * aside  # along the line, which the drag leaves as long as it is
    slopes = (
        u,
        v,
        w,
        -drive * f - turn * x - slowed * u - aside * x + sunk * x,
        -drive * g - turn * y - slowed * v - aside * y + sunk * y,
        -drive * h - turn * z - slowed * w + sunk * z,
    )
    ixx, iyy, _ = craft.inertia
    arm = below * craft.mass / (1.0 + ratio)
    forward, left = push[0] - ratio * body.force[0], push[1] - ratio * body.force[1]
    return (arm * left / ixx, -arm * forward / iyy, 0.0), push, slopes


def _fastest(values: Mapping[str, float]) -> float:
    """A swing at twice the weight, or what comes from the ground, 1/s."""
    swing = math.sqrt(2.0 * STANDARD_GRAVITY / values["length_m"]) + values["damping_per_s"]
    return max(swing, 2.0 * DRAG_PER_S)


EFFECT = Effect(
    name="slung_load",
    stage="body",
    law=law,
    order=10,  # of the force on the craft with its load
    states=(
        State("line x", moving=SWING, inertial="x"),
        State("line y", moving=SWING, inertial="y"),
        State("line z", -1.0),
        State("slope of line x", moving=SWING_PER_S, inertial="x"),
        State("slope of line y", moving=SWING_PER_S, inertial="y"),
        State("slope of line z"),
    ),
    fastest=_fastest,
    parameters=(
        Parameter(
            "percent",
            "%",
            default=7.0,
            low=0.5,
            high=50.0,
            least=0.0,
            most=90.0,
            bounds=(-20.0, 70.0),
            step=0.05,
        ),
        Parameter(
            "length_m",
            "m",
            default=0.3,
            low=0.05,
            high=2.5,
            absent=0.3,
            kind="shape",
            least=0.02,
            bounds=(0.04, 3.0),
            step=1e-3,
            tried=LENGTHS_M,
        ),
        Parameter(
            "damping_per_s",
            "1/s",
            default=0.4,
            low=0.0,
            high=4.0,
            absent=0.4,
            kind="shape",
            least=0.0,
            bounds=(0.0, 5.0),
            step=0.01,
        ),
        Parameter(
            "below_m",
            "m",
            default=0.01,
            low=-0.03,
            high=0.06,
            absent=0.01,
            kind="shape",
            bounds=(-0.05, 0.1),
            step=1e-4,
        ),
    ),
    adds="a load that swings below the craft pulls along its line; its weight is mass_change's",
    signature="the craft is pulled to and fro at a steady pace of its own, long after it stopped",
    excited_by="brisk flight to and fro with sudden stops, then hover for several swings",
    channels=("accelerometer x", "accelerometer y", *effect.TILT_RATES),
    regimes=effect.TRANSLATION | {"whole flight"},
    needs=("accelerometer", "attitude"),
    unmeasured=("height",),
    confused_with=(
        Confusion("rotor_drag", f"{effect.TRANSLATE}: drag ends with the motion, a load swings on"),
        Confusion("velocity_moment", f"{effect.TRANSLATE}: a moment ends with the motion"),
        Confusion("imu_lever_arm", f"{effect.HOVER_DOUBLETS}: no load follows them"),
    ),
)
