"""A fin behind the rotors: the air turns the craft, a moment after the craft has moved.

    yaw += moment * s,  ds/dt = (v - s) / lag,  v the velocity to the left

The air that meets the fin has passed the rotors; it follows the motion with a lag.
"""

from groundstation.dynamics.effect import Effect, Parameter, State


def fin(values, craft, body, state):
    moment, lag = values
    slope = (body.velocity[1] - state[0]) / lag
    return (0.0, 0.0, moment * state[0]), (0.0, 0.0, 0.0), (slope,)


EFFECT = Effect(
    name="yaw_weather_vane",
    stage="body",
    parameters=(
        Parameter("moment", "rad/s^2 per m/s", default=4.0, low=0.1, high=50.0),
        Parameter("lag_s", "s", default=0.2, low=0.02, high=2.0, kind="shape", bounds=(0.01, 3.0)),
    ),
    adds="yaw +moment s, where s follows the velocity to the left with a lag",
    signature="flying sideways yaws the craft, a moment later",
    excited_by="flight to the left and to the right at 1 m/s and more",
    channels=("gyro z",),
    states=(State("air"),),
    fastest=lambda values: 1.0 / values["lag_s"],
    needs=("accelerometer", "attitude"),
    unmeasured=("velocity",),
    law=fin,
)
