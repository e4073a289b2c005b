"""A propeller out of balance: a force in the rotors' plane, and a moment, that turn with it.

With e the direction that turns with the rotor and w = 2 pi n: force m r w^2 e at the hub, about z
its moment of the arm, and in the plane the moment c w^2 e. Static and couple unbalance (ISO
21940-2): m r in g mm, and c in g mm^2, to which a hub above the centre of gravity adds m r times
its height. Nobody measures the angle of e, so on a recorded flight its mean is all that can be
foreseen, which is nothing; a made flight begins with e forward.
"""

from __future__ import annotations

import math
from typing import Any

from groundstation.dynamics.effect import GYRO, SPIN, STEADY, Effect, Parameter, State


def law(values: Any, craft: Any, body: Any, state: Any) -> Any:
    """Angular and linear acceleration that it adds, and the slopes of its states: turns of the
    rotor, and whether their phase is known (1) or not (0)."""
    rotor = int(values[0]) - 1
    turns, known = state
    pace = 2.0 * math.pi * body.rotor[rotor]
    forward = known * pace * pace * math.cos(2.0 * math.pi * turns)
    left = -SPIN[rotor] * known * pace * pace * math.sin(2.0 * math.pi * turns)
    pull, twist = 1e-6 * values[1], 1e-9 * values[2]  # kg m, kg m^2
    ixx, iyy, izz = craft.inertia
    across = craft.rotor_x[rotor] * left - craft.rotor_y[rotor] * forward
    return (
        (twist * forward / ixx, twist * left / iyy, pull * across / izz),
        (pull * forward / craft.mass, pull * left / craft.mass, 0.0),
        (body.rotor[rotor], 0.0),
    )


EFFECT = Effect(
    name="propeller_imbalance",
    stage="body",
    law=law,
    states=(State("turns"), State("known phase", made=1.0)),
    parameters=(
        Parameter("rotor", "", default=1.0, low=1.0, high=4.0, kind="choice"),
        Parameter("imbalance_g_mm", "g mm", default=0.03, low=0.0, high=1.0, least=0.0),
        Parameter("couple_g_mm2", "g mm^2", default=0.3, low=0.0, high=20.0, least=0.0),
    ),
    adds="one rotor shakes the craft once in a turn: a force m r w^2 in its plane, a moment c w^2",
    signature="vibration at one rotor's speed, folded at the sample rate",
    excited_by="nothing special; thrust and yaw steps that keep the rotors' speeds apart",
    channels=(*GYRO, "accelerometer x", "accelerometer y"),
    regimes=STEADY,
)
