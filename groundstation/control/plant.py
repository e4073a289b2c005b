"""The craft as the closed-loop simulations turn it: that of ``simulate``, with the same effects.

A record of ``dynamics/craft.py``, and what lies between the craft and its controller. It begins
level, in a hover far from the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.control.firmwares import RELEASE_2014, Firmware, firmware_of_model
from groundstation.dynamics.craft import Crafts, craft_of_model, craft_of_motors
from groundstation.dynamics.effect import FAR_M
from groundstation.dynamics.model import Model, model_vehicle, rotor_motors
from groundstation.dynamics.sensors import SENSORS, sensors_of_model
from groundstation.dynamics.simulation import (
    RATE,
    ROTOR,
    accelerations,
    craft_state,
    hover_duty,
    hover_rev_s,
    with_states,
)
from groundstation.dynamics.vehicle import MIXERS
from groundstation.telemetry.arrays import Array

HOVER_REV_S = 230.0
"""Where a model without a body is flown: it does not say what carries the craft."""
NUDGE_RATE, NUDGE_SPEED = 1e-3, 1e-2
"""rad/s and rev/s, of the differences by which a hover is linearised."""


@dataclass(frozen=True, slots=True)
class Plant:
    """craft, sensor: records of shape (1,). hover_rev_s: rotor speed that carries the craft.
    mixer: (3, 4). fusion: the controller hears the firmware's attitude filter, not the truth.
    firmware: whose loops fly it.
    """

    craft: Crafts
    sensor: NDArray[np.void]
    hover_rev_s: float
    mixer: Array
    fusion: bool
    firmware: Firmware = RELEASE_2014

    @property
    def start(self) -> Array:
        """The state that a simulation begins in, (17 + those of effects,)."""
        state = craft_state((0.0, 0.0, FAR_M), rotor_rev_s=self.hover_rev_s)
        return np.array(with_states(self.craft, state[None])[0])

    @property
    def airframe_x(self) -> bool:
        return bool((self.mixer[0] != 0.0).all())

    def hover_duty(self, supply_mv: ArrayLike) -> Array:
        """Duty 0..1 (k,), mean of the rotors, that holds the hover at supplies (k,) in mV."""
        return hover_duty(self.craft, self.hover_rev_s, supply_mv)

    def hover_thrust(self, supply_mv: ArrayLike) -> Array:
        """The firmware's 16-bit thrust (k,) for it."""
        return self.firmware.thrust(self.hover_duty(supply_mv), supply_mv)

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
        return shown[-1] - s * lost


RESPONSE_S, RESPONSE_STEP_S = 0.5, 1e-4
"""Length and step of the sensors' step response."""


def plant_of_model(model: Model, fusion: bool = True, release: str | None = None) -> Plant:
    """A fitted model with all its effects.

    fusion: the controller hears the firmware's attitude filter; otherwise the true angles.
    release: of the firmware, None: the vehicle's.

    Raises BadInputError for a model without a body, or a firmware that cannot fly it.
    """
    vehicle, craft = model_vehicle(model), craft_of_model(model)
    mixer, firmware = MIXERS[vehicle.configuration], firmware_of_model(model, release)
    sensor = sensors_of_model(model)
    return Plant(craft, sensor, hover_rev_s(craft), mixer, fusion, firmware)


def motors_of_model(model: Model) -> Plant:
    """The motors of a model without a body."""
    craft = craft_of_motors(rotor_motors(model), {})
    mixer = MIXERS[model_vehicle(model).configuration]
    return Plant(craft, np.zeros(1, SENSORS), HOVER_REV_S, mixer, False)
