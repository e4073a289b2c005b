"""The craft as the closed-loop simulations turn it: that of ``simulate``, with the same effects.

A record of ``dynamics/craft.py``, and what lies between the craft and its controller. It begins
level, in a hover far from the ground. Where a model's ARX polynomials turn it, they stand in the
place of the body's rotation, of its sensors and of their delay; rotors, thrust and the way through
space stay the body's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.control.firmwares import RELEASE_2014, Firmware, firmware_of_vehicle
from groundstation.dynamics.arx import AXES, SLOPE_ROWS, Turning, of_rates, stacked, turning_of
from groundstation.dynamics.arx_period import at_period
from groundstation.dynamics.craft import Crafts, craft_of_model, craft_of_motors
from groundstation.dynamics.hover import hover_duty, hover_rev_s
from groundstation.dynamics.law import FAR_M
from groundstation.dynamics.mixer import MIXERS
from groundstation.dynamics.model import Model, model_vehicle, rotor_motors
from groundstation.dynamics.sensors import SENSORS, sensors_of_model
from groundstation.dynamics.simulation import accelerations, with_states
from groundstation.dynamics.state import RATE, ROTOR, craft_state
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
HOVER_REV_S = 230.0
"""Where a model without a body is flown: it does not say what carries the craft."""
NUDGE_RATE, NUDGE_SPEED = 1e-3, 1e-2
"""rad/s and rev/s, of the differences by which a hover is linearised."""


BODY_TURNS, ANGLES, RATES = 0, 1, 2
"""What turns the craft: its body, or polynomials of its angles or of its rates."""


@dataclass(frozen=True, slots=True)
class Polynomials:
    """From u' in (rev/s)^2, a mean over the period that ends with a row, to an angle in rad or a
    rate in rad/s: a (3, na) from a1, b (3, nb), nk (3,) of roll, pitch and yaw. turns: ``ANGLES``
    or ``RATES``, without any ``BODY_TURNS``."""

    turns: int
    a: Array
    b: Array
    nk: NDArray[np.int64]

    def rate(self, axis: int, z: Complex) -> Complex:
        """The rate in rad/s per u' at points z (n,) of the unit circle; that of an angle is its
        slope over two rows."""
        lags = z[:, None] ** -np.arange(1.0 + max(self.a.shape[1], self.b.shape[1]))
        given = lags[:, : self.b.shape[1]] @ self.b[axis] * z ** -float(self.nk[axis])
        output = given / (1.0 + lags[:, 1 : 1 + self.a.shape[1]] @ self.a[axis])
        return np.asarray(output if self.turns == RATES else output / self.angle(z))

    def angle(self, z: Complex) -> Complex:
        """The angle in rad per rate, of polynomials of angles."""
        return np.asarray(SLOPE_ROWS * SAMPLE_PERIOD_S / (1.0 - z**-SLOPE_ROWS))

    def phase(self, axis: int, z: complex) -> float:
        """Of ``rate`` in rad at one point near z = 1, not wrapped: an unstable pole turns it by
        half a turn, a pair of them by a whole one (Nyquist counts them)."""
        poles = np.roots(np.concatenate([[1.0], self.a[axis]]))
        turned = np.angle(1.0 - poles / z)
        turned[(np.abs(poles) > 1.0) & (poles.imag < 0.0)] += 2.0 * np.pi
        driven = self.rate(axis, np.array([z]))[0] * np.prod(1.0 - poles / z)
        return float(np.angle(driven) - turned.sum())


NO_POLYNOMIALS = Polynomials(BODY_TURNS, np.zeros((3, 0)), np.zeros((3, 0)), np.zeros(3, np.int64))


@dataclass(frozen=True, slots=True)
class Plant:
    """craft, sensor: records of shape (1,). hover_rev_s: rotor speed that carries the craft.
    mixer: (3, 4). fusion: the controller hears the firmware's attitude filter, not the truth.
    firmware: whose loops fly it. polynomials: of rows 2 ms apart, what turns it where they are.
    """

    craft: Crafts
    sensor: NDArray[np.void]
    hover_rev_s: float
    mixer: Array
    fusion: bool
    firmware: Firmware = RELEASE_2014
    polynomials: Polynomials = NO_POLYNOMIALS

    @property
    def start(self) -> Array:
        """The state that a simulation begins in, (17 + those of effects,)."""
        state = craft_state((0.0, 0.0, FAR_M), rotor_rev_s=self.hover_rev_s)
        return np.array(with_states(self.craft, state[None])[0])

    @property
    def airframe_x(self) -> bool:
        return bool((self.mixer[0] != 0.0).all())

    @property
    def turned_by(self) -> tuple[Any, ...]:
        """What turns it as kernels take it: kind, a, b, nk, mixer."""
        one = self.polynomials
        return one.turns, one.a, one.b, one.nk, self.mixer

    def hover_duty(self, supply_mv: ArrayLike) -> Array:
        """Duty 0..1 (k,), mean of the rotors, that holds the hover at supplies (k,) in mV."""
        return hover_duty(self.craft, self.hover_rev_s, supply_mv)

    def hover_thrust(self, supply_mv: ArrayLike) -> Array:
        """The firmware's 16-bit thrust (k,) for it."""
        return self.firmware.thrust(self.hover_duty(supply_mv), supply_mv)

    def input_slope(self, axis: int) -> float:
        """u' of an axis in (rev/s)^2 per rev/s by which all rotors that turn it are moved."""
        return float(2.0 * self.hover_rev_s * np.abs(self.mixer[axis]).sum())

    def slopes(self, axis: int) -> tuple[float, float, float]:
        """Around the hover, of the angular acceleration of an axis: damping in 1/s, by the speed of
        all rotors moved as the mixer says in (rad/s^2) per rev/s, and by their slope."""
        moved = np.sign(self.mixer[axis])

        def turn(rate: float, speed: float, slope: float) -> float:
            state = self.start[None, : RATE.stop + 4].copy()
            state[0, RATE.start + axis] = rate
            state[0, ROTOR] += speed * moved
            found = accelerations(self.craft, state, slope * moved[None])
            return float(found[0, axis])

        by_rate = (turn(NUDGE_RATE, 0, 0) - turn(-NUDGE_RATE, 0, 0)) / (2 * NUDGE_RATE)
        by_speed = (turn(0, NUDGE_SPEED, 0) - turn(0, -NUDGE_SPEED, 0)) / (2 * NUDGE_SPEED)
        return -by_rate, by_speed, 0.5 * (turn(0, 0, 1.0) - turn(0, 0, -1.0))

    def gyro_response(self, s: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """What the gyro makes of a rate at s (n,) in 1/s, without the delay."""
        if not self.craft[0]["sensor_states"]:
            return np.ones_like(s)
        from groundstation.dynamics.sensing import gyro_step

        shown = np.empty(round(RESPONSE_S / RESPONSE_STEP_S))
        gyro_step(self.craft[0], RESPONSE_STEP_S, shown)
        time = RESPONSE_STEP_S * (np.arange(len(shown)) + 0.5)
        left = shown[-1] - shown
        lost = (np.exp(-np.outer(s, time)) @ left) * RESPONSE_STEP_S
        return np.asarray(shown[-1] - s * lost)


RESPONSE_S, RESPONSE_STEP_S = 0.5, 1e-4
"""Length and step of the sensors' step response."""


def plant_of_model(
    model: Model,
    fusion: bool = True,
    release: str | None = None,
    turning: Turning | None = None,
) -> Plant:
    """A fitted model with all its effects.

    fusion: the controller hears the firmware's attitude filter; otherwise the true angles.
    release: of the firmware, None: the vehicle's. turning: what turns the craft, None: its ARX
    polynomials where they were fitted; those of angles are what the filter reports already.

    Raises BadInputError for a model without a body, or a firmware that cannot fly it.
    """
    vehicle, craft = model_vehicle(model), craft_of_model(model)
    mixer, firmware = MIXERS[vehicle.configuration], firmware_of_vehicle(vehicle, release)
    polynomials = NO_POLYNOMIALS
    if turning_of(model, turning) == "arx":
        turns = RATES if of_rates(model) else ANGLES
        faster = at_period(model, SAMPLE_PERIOD_S).arx or {}
        polynomials = Polynomials(turns, *stacked([faster[axis] for axis in AXES]))
        fusion = fusion and turns == RATES
    sensor = sensors_of_model(model)
    return Plant(craft, sensor, hover_rev_s(craft), mixer, fusion, firmware, polynomials)


def motors_of_model(model: Model) -> Plant:
    """The motors of a model without a body."""
    craft = craft_of_motors(rotor_motors(model), {})
    mixer = MIXERS[model_vehicle(model).configuration]
    return Plant(craft, np.zeros(1, SENSORS), HOVER_REV_S, mixer, False)
