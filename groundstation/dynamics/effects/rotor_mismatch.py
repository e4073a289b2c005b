"""One rotor stronger or weaker than the others: its thrust and drag times 1 + excess.

Source: a nicked or bent propeller; both coefficients scale with the blade.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import GYRO, SPIN, STEADY, THRUST, Confusion, Effect, Parameter


def law(values: Any, craft: Any, body: Any, wrench: Any) -> Any:
    """Thrust and torques with the rotor's surplus."""
    rotor = int(values[0]) - 1
    speed = body.rotor[rotor]
    surplus = values[1] * speed * speed
    force = craft.thrust * surplus
    thrust, roll, pitch, yaw = wrench
    return (
        thrust + force,
        roll + craft.rotor_y[rotor] * force,
        pitch - craft.rotor_x[rotor] * force,
        yaw + SPIN[rotor] * craft.drag * surplus,
    )


EFFECT = Effect(
    name="rotor_mismatch",
    stage="rotor",
    law=law,
    parameters=(
        Parameter("rotor", "", default=1.0, low=1.0, high=4.0, kind="choice"),
        Parameter(
            "excess",
            "",
            default=0.05,
            low=-0.4,
            high=0.4,
            bounds=(-0.6, 0.6),
            step=0.01,
            worth=0.05,
        ),
    ),
    adds="thrust and drag of one rotor times 1 + excess",
    signature="constant torque about roll or pitch AND yaw, in the ratio that one rotor gives",
    excited_by="steps of collective thrust and of yaw",
    channels=(*GYRO, "accelerometer z"),
    regimes=STEADY | THRUST,
    confused_with=(
        Confusion(
            "centre_of_gravity_offset",
            "yaw and thrust steps: an offset changes neither yaw torque nor total thrust",
        ),
    ),
)
