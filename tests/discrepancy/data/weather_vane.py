"""A fin behind the centre of gravity, which the list of effects lacks."""

import math

from groundstation.dynamics.effects.catalogue import Effect, Parameter


def vane(values, state, rotor_slope, acceleration):
    turn, fade = values
    w, x, y, z = state[6], state[7], state[8], state[9]
    # The velocity along the body's y axis, to the left.
    left = (
        2.0 * (x * y - w * z) * state[3]
        + (1.0 - 2.0 * (x * x + z * z)) * state[4]
        + 2.0 * (y * z + w * x) * state[5]
    )
    acceleration[2] += turn * fade * math.tanh(left / fade)


VANE = Effect(
    name="weather_vane",
    stage="body",
    parameters=(
        Parameter("turn", "rad/s^2 per m/s", default=4.0, low=0.1, high=50.0),
        Parameter("fade", "m/s", default=10.0, low=1.0, high=100.0, absent=10.0),
    ),
    adds="yaw turns towards where the air comes from",
    signature="flying sideways yaws the craft",
    excited_by="flight to the left and to the right at 1 m/s and more",
    channels=("gyro z",),
    law=vane,
)
