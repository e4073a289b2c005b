"""What the law of an effect is given and returns, stage by stage.

A law is a plain function of numbers and of the named tuples below, in Python that numba compiles:
it takes its parameters' values as a tuple in their order and returns tuples; it stores nothing.
The stages, in the order in which a flight passes them:

| stage | law | returns |
|---|---|---|
| delay | (values) | how late every measurement is, s |
| supply | (values, craft, supply, supply_mv) | voltage behind the report, mV |
| motor | (values, motor, slope) | dn/dt of one motor, rev/s^2 |
| rotor | (values, craft, body, wrench) | thrust (N) and torque about x, y, z (N m) |
| body | (values, craft, body) | ((3,) rad/s^2, (3,) m/s^2), body axes: what it adds |
| sensor | (values, craft, body, reading) | a ``Reading`` |
| tachometer | (values) | time constant of the sensor behind recorded rotor speeds, s |
| attitude | (values) | proportional and integral gain of the attitude filter, 1/s and 1/s^2 |

A body or sensor effect that declares states takes them as a last argument, a tuple, and returns
one more item: the tuple of their slopes. Where several effects act at a stage each is given what
the ones before it left (``Effect.order``).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]

SPIN: Four = (-1.0, 1.0, -1.0, 1.0)
"""Sign of each rotor's drag torque about z: M1 and M3 turn counter-clockwise (thesis eq. 3.20)."""
STATE_SLOTS = 16
"""States that a user's own effects may have together at a stage."""
VALUE_SLOTS = 16
"""Parameters of all own effects of a model together."""
FAR_M = 1000.0
"""Height of a craft that no ground touches."""


class Craft(NamedTuple):
    """What is constant in a flight: SI, rotor speed in rev/s.

    thrust: N, drag: N m, per (rev/s)^2 of a rotor. rotor_x, rotor_y: m forward and left. a0, a1,
    a2: of each motor (thesis eq. 3.82). back_emf_mv: of each, mV per rev/s, its bound a1/a0.
    """

    mass: float
    gravity: float
    inertia: Three
    thrust: float
    drag: float
    rotor_x: Four
    rotor_y: Four
    a0: Four
    a1: Four
    a2: Four
    winding_ohm: float
    back_emf_mv: Four


class Supply(NamedTuple):
    """The reported battery voltage in mV at a row and at the row before, and what it drives."""

    reported: float
    before: float
    period_s: float
    duty: Four
    rotor: Four


class Motor(NamedTuple):
    """One motor: constants of eq. 3.82, armature voltage in mV, speed in rev/s."""

    a0: float
    a1: float
    a2: float
    armature_mv: float
    rev_s: float


class Body(NamedTuple):
    """The craft at an instant, in body axes (forward, left, up) unless said otherwise.

    height: m above the ground, ``FAR_M`` where it is not known. quaternion: body to inertial.
    velocity: m/s over ground. rate: rad/s. rotor: rev/s, rotor_slope: rev/s^2. thrust: N, of all
    rotors. angular: rad/s^2 and force: m/s^2 (specific force) as far as they are reckoned:
    at the body stage by the effects before, at the sensor stage completely.
    """

    height: float
    quaternion: Four
    velocity: Three
    rate: Three
    rotor: Four
    rotor_slope: Four
    thrust: float
    angular: Three
    force: Three


class Reading(NamedTuple):
    """What the sensors show: gyro in rad/s, accelerometer in m/s^2, rotor speeds in rev/s."""

    gyro: Three
    accelerometer: Three
    rotor: Four


def to_inertial(quaternion: Any, vector: Any) -> Three:
    """A body vector in inertial axes; quaternion (w, x, y, z) body to inertial."""
    w, x, y, z = quaternion
    a, b, c = vector
    return (
        (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c,
        2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c,
        2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c,
    )


def to_body(quaternion: Any, vector: Any) -> Three:
    """An inertial vector in body axes."""
    w, x, y, z = quaternion
    return to_inertial((w, -x, -y, -z), vector)


def butterworth_slopes(given: Any, state: Any, corner_hz: float) -> Any:
    """Slopes of three signals behind a low-pass of second order, and of their slopes.

    given: the signals (3); state: what has passed and its slopes (6).
    """
    pace = 2.0 * math.pi * corner_hz
    stiff, damped = pace * pace, math.sqrt(2.0) * pace
    x, y, z = given
    return (
        state[3],
        state[4],
        state[5],
        stiff * (x - state[0]) - damped * state[3],
        stiff * (y - state[1]) - damped * state[4],
        stiff * (z - state[2]) - damped * state[5],
    )


def butterworth_behind(state: Any, corner_hz: float) -> Any:
    """How far the integrals of three signals behind that low-pass are behind the signals' own:
    with w'' = (2 pi f)^2 (u - w) - sqrt(2) 2 pi f w', what is missing of u is in w and w'."""
    pace = 2.0 * math.pi * corner_hz
    late, later = math.sqrt(2.0) / pace, 1.0 / (pace * pace)
    return (
        late * state[0] + later * state[3],
        late * state[1] + later * state[4],
        late * state[2] + later * state[5],
    )


def rotor_wrench(craft: Any, rotor: Any) -> tuple[float, float, float, float]:
    """Thrust (3.13) and torques (3.21 with lever; yaw by drag only) of equal rotors, N and N m.

    rotor: rev/s, four numbers.
    """
    n1, n2, n3, n4 = rotor
    s1, s2, s3, s4 = n1 * n1, n2 * n2, n3 * n3, n4 * n4
    (x1, x2, x3, x4), (y1, y2, y3, y4) = craft.rotor_x, craft.rotor_y
    return (
        craft.thrust * (s1 + s2 + s3 + s4),
        craft.thrust * (y1 * s1 + y2 * s2 + y3 * s3 + y4 * s4),
        -craft.thrust * (x1 * s1 + x2 * s2 + x3 * s3 + x4 * s4),
        craft.drag * (SPIN[0] * s1 + SPIN[1] * s2 + SPIN[2] * s3 + SPIN[3] * s4),
    )
