"""A model flown along a reference by a simple controller, with everything it would report.

The controller knows the true state: angle and height loops ask for accelerations, the mixer's
constants turn these into rotor speeds, and each motor is driven to its speed in ``MOTOR_S``. It
is there to keep an unstable craft in the air, not to be a model of a firmware: for closed loops
with delay and real controllers see ``groundstation.control`` and the stand-in. What is reported
is then made from the same inputs by the model with all its effects, sensors included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.hover import duties_for, hover_rev_s
from groundstation.dynamics.model import Model
from groundstation.dynamics.reference import Reference
from groundstation.dynamics.sensors import FILTER, resting_sensors, shown_rotors
from groundstation.dynamics.simulation import simulate, with_states
from groundstation.dynamics.state import QUATERNION, RATE, ROTOR, attitude_of, craft_state
from groundstation.errors import BadInputError
from groundstation.prediction.drive import Drive, drive_run
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S, STANDARD_GRAVITY

ANGLE_RAD_S, ANGLE_DAMPING, ANGLE_INTEGRAL = 7.0, 0.9, 40.0
HEIGHT_RAD_S, HEIGHT_DAMPING = 3.0, 1.0
MOTOR_S = 0.025
PIECE_ROWS = 50
LOST_RAD = 1.4
"""A tilt from which the controller does not come back."""


@dataclass(frozen=True, slots=True)
class MadeRun:
    """A simulated flight with the channels of a run: rows 2 ms apart.

    duty: (n, 4); supply_v: (n,) as reported; gyro (n, 3) rad/s, accelerometer (n, 3) m/s^2 and
    attitude (n, 3) rad as reported, without noise; rotor_rev_s: (n, 4) behind each row; states:
    (n, 17), the true ones at each row; reference: (n, 3) rad.
    """

    period_s: float
    duty: Array
    supply_v: Array
    gyro: Array
    accelerometer: Array
    attitude: Array
    rotor_rev_s: Array
    states: Array
    reference: Array

    @property
    def settings(self) -> Array:
        """The duty: rows are as fast as the motors are set."""
        return self.duty


def fly_reference(model: Model, reference: Reference, supply_v: float = 3.7) -> MadeRun:
    """Fly a model along a reference, from a hover, at a steady supply voltage.

    Raises BadInputError where the model cannot hover at that voltage, or falls.
    """
    duty, states = _closed_loop(model, reference, supply_v)
    n = len(duty)
    volts = np.full(n, supply_v)
    nothing = np.zeros((n, 3))
    run = MadeRun(SAMPLE_PERIOD_S, duty, volts, nothing, nothing, nothing, nothing, states, nothing)
    made = replace(_report(drive_run(model, run), run), reference=reference.attitude[:n])
    return replace(made, rotor_rev_s=shown_rotors(model, made.rotor_rev_s, made.period_s))


def _closed_loop(model: Model, reference: Reference, supply_v: float) -> tuple[Array, Array]:
    """Duty (n, 4), row i acting before sample i, and true states (n, 17 + those of effects)."""
    craft = craft_of_model(model)
    one = craft[0]
    supply = 1000.0 * supply_v
    # Rotor speeds from wanted accelerations: the inverse of mixer and constants.
    mixing = np.vstack(
        [
            one["rotor_y"] * one["thrust"] / one["inertia"][0],
            -one["rotor_x"] * one["thrust"] / one["inertia"][1],
            np.array([-1.0, 1.0, -1.0, 1.0]) * one["drag"] / one["inertia"][2],
            np.full(4, one["thrust"] / one["mass"]),
        ]
    )
    inverse = np.linalg.inv(mixing)
    hover = hover_rev_s(craft)
    state = craft_state(
        position_m=(0.0, 0.0, reference.height_m[0]),
        attitude=(0.0, 0.0, reference.attitude[0, 2]),
        rotor_rev_s=hover,
    )
    state = with_states(craft, state[None], made=True)[0]
    n = len(reference)
    duty, states = np.empty((n, 4)), np.empty((n, len(state)))
    duty[0] = duties_for(craft, state[ROTOR], np.zeros(4), supply)
    if duty[0].max() > 0.95:
        raise BadInputError(
            f"model for {model.vehicle}: to hover at {supply_v:g} V takes"
            f" {100 * duty[0].max():.0f} % of full duty; give more voltage"
        )
    states[0] = state
    integral = np.zeros(3)
    for row in range(1, n):
        attitude = attitude_of(state)
        if np.abs(attitude[:2]).max() > LOST_RAD or not np.isfinite(state).all():
            raise BadInputError(
                f"reference {reference.name}: the craft falls after {row * SAMPLE_PERIOD_S:.2f} s;"
                " ask for less tilt, or look at the model's effects"
            )
        error = reference.attitude[row] - attitude
        error[2] = np.angle(np.exp(1j * error[2]))
        integral = np.clip(integral + error * SAMPLE_PERIOD_S, -0.5, 0.5)
        turn = ANGLE_RAD_S**2 * error + ANGLE_INTEGRAL * integral
        turn -= 2.0 * ANGLE_DAMPING * ANGLE_RAD_S * state[RATE]
        climb = HEIGHT_RAD_S**2 * (reference.height_m[row] - state[2])
        climb -= 2.0 * HEIGHT_DAMPING * HEIGHT_RAD_S * state[5]
        lift = (STANDARD_GRAVITY + np.clip(climb, -4.0, 4.0)) / (
            np.cos(attitude[0]) * np.cos(attitude[1])
        )
        wanted = np.sqrt(np.maximum(inverse @ [*turn, lift], (0.3 * hover) ** 2))
        speed = state[ROTOR]
        duty[row] = duties_for(craft, speed, (wanted - speed) / MOTOR_S, supply)
        (_, state) = simulate(
            craft, state, duty[row : row + 1] * supply, supply_mv=np.array([supply])
        )
        states[row] = state
    return duty, states


def _report(drive: Drive, run: MadeRun) -> MadeRun:
    """The channels that the model's sensors show of a flight whose true states are known.

    Flown again in short pieces from true states: an open loop would magnify rounding errors.
    """
    from groundstation.prediction.kernels import coast

    n = len(run.duty)
    late = np.maximum(np.arange(n) * run.period_s - float(drive.sensor[0]["delay"]), 0.0)
    states = _between(run.states, late / run.period_s)
    sensed, report = resting_sensors(drive.craft[0])[None], states[:1, QUATERNION].copy()
    leaning = np.zeros((1, FILTER))
    leaning[0, :4], leaning[0, 6] = report[0], STANDARD_GRAVITY
    shown = np.empty((n, 9))
    fresh = np.arange(n) % 2 == 0
    for row in range(0, n - 1, PIECE_ROWS):
        ahead = np.arange(1, min(PIECE_ROWS, n - 1 - row) + 1)
        measured = np.empty((1, len(ahead), 9))
        coast(
            drive.craft[0],
            drive.sensor[0],
            drive.speed,
            run.period_s,
            fresh,
            np.array([row]),
            ahead,
            states[row : row + 1].copy(),
            sensed,
            leaning,
            report,
            measured,
        )
        shown[row + 1 : row + 1 + len(ahead)] = measured[0]
    shown[0] = shown[1]
    gyro, accelerometer, attitude = (shown[:, i : i + 3].copy() for i in (0, 3, 6))
    return replace(
        run,
        gyro=gyro,
        accelerometer=accelerometer,
        attitude=np.unwrap(attitude, axis=0),
        rotor_rev_s=drive.rotor_rev_s,
    )


def _between(states: Array, at: Array) -> Array:
    """States between rows, by Hermite's cubic over central differences."""
    from scipy.interpolate import CubicHermiteSpline

    grid = np.arange(len(states))
    found = np.asarray(CubicHermiteSpline(grid, states, np.gradient(states, axis=0))(at))
    found[:, QUATERNION] /= np.linalg.norm(found[:, QUATERNION], axis=1)[:, None]
    return found
