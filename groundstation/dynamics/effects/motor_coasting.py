"""Motors that coast: below its back EMF a motor is braked by less than eq. 3.82 says.

Source: one switch per motor and a diode (brushed Crazyflies); the current can flow one way only.
Where it would flow back, a0 u < a1 n, ``share`` of it does not: 1 is a motor that falls by its
load alone. Pulses of the PWM still drive current below the back EMF (discontinuous conduction), so
a real share is less; a1/a0 stands for the back EMF, its upper bound.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import GYRO, ROTORS, TILTING, Confusion, Effect, Parameter


def law(values: Any, motor: Any, slope: float) -> float:
    """dn/dt without that share of a braking current."""
    braking = -slope - motor.a2 * motor.rev_s * motor.rev_s
    found: float = slope + values[0] * max(braking, 0.0)
    return found


EFFECT = Effect(
    name="motor_coasting",
    stage="motor",
    law=law,
    order=1,  # of the current that is left behind a dead voltage
    parameters=(
        Parameter(
            "share", "", default=0.7, low=0.05, high=1.0, bounds=(-0.3, 1.3), step=0.02, stride=0.3
        ),
    ),
    adds="where a0 u < a1 n, that share of a1 n - a0 u does not brake",
    signature="thrust is higher than in the model while commands swing fast and far; steps far down"
    " fall by drag alone",
    excited_by="thrust steps far down, commands that swing by a third of hover within 10 ms",
    channels=("accelerometer z", *GYRO),
    regimes=ROTORS | TILTING | {"after yaw commands", "low thrust"},
    needs=("modelled rotors",),
    confused_with=(
        Confusion(
            "motor_braking_asymmetry",
            "thrust steps down by 10 % and by 60 %: a motor coasts on the large ones only",
        ),
    ),
)
