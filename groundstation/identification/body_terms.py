"""The body's equations as a prediction of angular acceleration, with the named effects in them.

The rates are measured, so the body is written row by row: the step of a gyro axis over one
period, divided by it, is a mean angular acceleration; c0, c1, c2 multiply the mixer's mean u'
over the same time (thesis eq. 7.12-7.14 and 7.20-7.22). Each named effect adds its torque, or
changes what the motors or the sensor do, with the laws and parameters of
``dynamics/effects/catalogue.py``. Inertias are those that the constants imply: Ixx = k l / c0 with
k = mass x thrust_per_mass, as models are flown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effects.catalogue import EFFECTS
from groundstation.dynamics.mixer import MIXERS
from groundstation.dynamics.motor import REVOLUTION
from groundstation.dynamics.vehicle import MotorConstants, Vehicle, lever_arm_m
from groundstation.errors import BadInputError
from groundstation.identification.stretches import Stretch
from groundstation.identification.torque import RotorSquares, rotor_squares
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]

SPIN: Array = np.array([-1.0, 1.0, -1.0, 1.0])
LEAK_S = 2.0
"""Time constant with which the velocity, integrated from tilt, forgets."""
SUPPLY_EFFECTS = ("battery_reading_lag", "supply_sag")
"""Undone before the fit, from the report itself (``supply.py``): they change what drives the
motors, and a flight's rates alone cannot tell them from other constants."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """A parameter of an effect as the fit sees it.

    start: where the search begins; 0 or a value that means absent. step: for the derivative.
    low, high: hard limits of the search. most: largest change in one step.
    """

    name: str
    start: float
    step: float
    low: float = -math.inf
    high: float = math.inf
    most: float = math.inf


FITTED: dict[str, tuple[Fitted, ...]] = {
    "dead_time": (Fitted("delay_s", 0.0, 2e-4, 0.0, 0.03, 1e-3),),
    "gyro_low_pass": (Fitted("lag_s", 1e-3, 1e-4, 0.0, 0.05, 3e-3),),
    "imu_misalignment": (
        Fitted("roll_deg", 0.0, 0.5, -30.0, 30.0, 5.0),
        Fitted("pitch_deg", 0.0, 0.5, -30.0, 30.0, 5.0),
        Fitted("yaw_deg", 0.0, 0.5, -30.0, 30.0, 5.0),
    ),
    "rotor_gyroscopic_torque": (Fitted("rotor_inertia_kg_m2", 0.0, 1e-8),),
    "rotor_acceleration_torque": (Fitted("rotor_inertia_kg_m2", 0.0, 1e-8),),
    "inertia_coupling": (Fitted("fraction", 0.0, 0.1),),
    "rate_damping": (Fitted("damping_n_m_s", 0.0, 1e-6),),
    "quadratic_rate_damping": (Fitted("damping_n_m_s2", 0.0, 1e-6),),
    "yaw_damping": (Fitted("damping_n_m_s", 0.0, 1e-6),),
    "centre_of_gravity_offset": (
        Fitted("x_m", 0.0, 1e-4, -0.02, 0.02),
        Fitted("y_m", 0.0, 1e-4, -0.02, 0.02),
    ),
    "rotor_mismatch": (Fitted("excess", 0.0, 0.01, -0.6, 0.6),),
    "velocity_moment": (Fitted("moment", 0.0, 1.0),),
    "motor_dead_voltage": (Fitted("voltage_mv", 0.0, 10.0, -1500.0, 1500.0, 200.0),),
    "motor_braking_asymmetry": (Fitted("factor", 1.0, 0.02, 0.05, 5.0, 0.2),),
}
"""Effects whose parameters the body fit estimates. Inside, a low-pass is a lag in seconds (its
bandwidth would be infinite where there is none), and the mismatched rotor is searched."""
FIT_WITH = (*FITTED, *SUPPLY_EFFECTS)


def require_known(names: Sequence[str]) -> None:
    """Raises BadInputError for an effect that cannot be fitted along, with the reason."""
    for name in names:
        if name in FIT_WITH:
            continue
        if name in EFFECTS:
            raise BadInputError(
                f"--with {name}: it shows in {', '.join(EFFECTS[name].channels)}, and the body"
                " fit explains the rates; 'groundstation discrepancy' finds and fits it"
            )
        raise BadInputError(f"--with {name}: the body fit knows {', '.join(FIT_WITH)}")


class BodyTerms:
    """Predicts the angular acceleration of stretches from named values.

    vehicle: configuration, arm, mass, and the ratio of the inertias. thrust_per_mass: with the
    mass it gives the inertias' scale. effects: names in ``FITTED`` that act. rotor: index of the
    mismatched rotor.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        thrust_per_mass: float,
        effects: Sequence[str] = (),
        rotor: int = 0,
    ) -> None:
        self.vehicle, self.effects, self.rotor = vehicle, tuple(effects), rotor
        self.thrust_n = vehicle.mass_kg * thrust_per_mass
        self.mixer = MIXERS[vehicle.configuration]
        self._rotors = cache(self._simulated)
        self._late = cache(self._shifted)
        self._speed = cache(self._velocity)
        self._stretches: dict[int, Stretch] = {}

    def acceleration(
        self,
        stretch: Stretch,
        values: Mapping[str, float],
        motor: MotorConstants | None = None,
    ) -> Array:
        """Modelled mean acceleration of the gyro over each row's period, (n, 3) rad/s^2.

        values: c0, c1, c2 and ``effect.parameter`` for each effect that acts. motor: other
        constants than the stretch's own.
        """
        key = id(stretch)
        self._stretches[key] = stretch  # keeps the id alive
        used = self._motor_key(stretch, values, motor)
        late = self._late(key, used, values.get("dead_time.delay_s", 0.0))
        constants = np.array([values["c0"], values["c1"], values["c2"]])
        squares = late.squares
        if "rotor_mismatch.excess" in values:
            squares = squares.copy()
            squares[:, self.rotor] *= 1.0 + values["rotor_mismatch.excess"]
        total = squares @ self.mixer.T * constants
        self._add_torques(total, stretch, values, constants, squares, late)
        if "imu_misalignment.roll_deg" in values:
            total = total @ _turned(values)
        lag = values.get("gyro_low_pass.lag_s", 0.0)
        return _lagged(total, lag, stretch.run.period_s) if lag > 0.0 else total

    def squares(
        self,
        stretch: Stretch,
        values: Mapping[str, float],
        motor: MotorConstants | None = None,
    ) -> RotorSquares:
        """Squared rotor speeds of the stretch's whole run under these values."""
        self._stretches[id(stretch)] = stretch
        return self._rotors(id(stretch.run), id(stretch), self._motor_key(stretch, values, motor))

    def forget(self) -> None:
        """Drop what was kept from earlier values."""
        self._rotors.cache_clear()
        self._late.cache_clear()

    def _add_torques(
        self,
        total: Array,
        stretch: Stretch,
        values: Mapping[str, float],
        constants: Array,
        squares: Array,
        late: _Late,
    ) -> None:
        ixx, iyy, izz = self._inertia(constants)
        # Rates that multiply something are those of the row before: the present row's noise is
        # in the acceleration too, and a product with it would look like damping.
        p, q, r = stretch.run.gyro[stretch.first - 1 : stretch.last - 1].T
        for effect in self.effects:
            if effect == "inertia_coupling":
                share = values["inertia_coupling.fraction"]
                total[:, 0] += share * (iyy - izz) / ixx * q * r
                total[:, 1] += share * (izz - ixx) / iyy * p * r
                total[:, 2] += share * (ixx - iyy) / izz * p * q
            elif effect == "rotor_gyroscopic_torque":
                inertia = values["rotor_gyroscopic_torque.rotor_inertia_kg_m2"]
                total[:, 0] += inertia / ixx * q * late.spin
                total[:, 1] -= inertia / iyy * p * late.spin
            elif effect == "rotor_acceleration_torque":
                inertia = values["rotor_acceleration_torque.rotor_inertia_kg_m2"]
                total[:, 2] += inertia / izz * late.spin_up
            elif effect == "rate_damping":
                damping = values["rate_damping.damping_n_m_s"]
                total[:, 0] -= damping / ixx * p
                total[:, 1] -= damping / iyy * q
            elif effect == "quadratic_rate_damping":
                damping = values["quadratic_rate_damping.damping_n_m_s2"]
                total[:, 0] -= damping / ixx * p * np.abs(p)
                total[:, 1] -= damping / iyy * q * np.abs(q)
            elif effect == "yaw_damping":
                total[:, 2] -= values["yaw_damping.damping_n_m_s"] / izz * r
            elif effect == "centre_of_gravity_offset":
                thrust = self.thrust_n * squares.sum(axis=1)
                total[:, 0] -= values["centre_of_gravity_offset.y_m"] * thrust / ixx
                total[:, 1] += values["centre_of_gravity_offset.x_m"] * thrust / iyy
            elif effect == "velocity_moment":
                forward, left = self._speed(id(stretch)).T
                total[:, 0] += values["velocity_moment.moment"] * left
                total[:, 1] -= values["velocity_moment.moment"] * forward

    def _inertia(self, constants: Array) -> tuple[float, float, float]:
        """Ixx, Iyy, Izz in kg m^2 behind c0 and c1 (as ``craft_of_model``)."""
        lever = lever_arm_m(self.vehicle)
        ixx, iyy = self.thrust_n * lever / np.maximum(np.abs(constants[:2]), 1e-9)
        of_profile = self.vehicle.inertia_kg_m2
        return ixx, iyy, of_profile[2] / (of_profile[0] + of_profile[1]) * (ixx + iyy)

    def _motor_key(
        self, stretch: Stretch, values: Mapping[str, float], motor: MotorConstants | None
    ) -> tuple[MotorConstants | None, float, float]:
        if stretch.motor is None:  # measured speeds
            return None, 0.0, 1.0
        return (
            motor or stretch.motor,
            values.get("motor_dead_voltage.voltage_mv", 0.0),
            values.get("motor_braking_asymmetry.factor", 1.0),
        )

    def _simulated(
        self, _run: int, stretch: int, key: tuple[MotorConstants | None, float, float]
    ) -> RotorSquares:
        one = self._stretches[stretch]
        motor, dead_mv, braking = key
        if motor is None or (motor == one.motor and dead_mv == 0.0 and braking == 1.0):
            return one.squares
        return rotor_squares(one.run, motor, dead_mv=dead_mv, braking=braking)

    def _shifted(
        self, stretch: int, key: tuple[MotorConstants | None, float, float], delay_s: float
    ) -> _Late:
        from groundstation.identification.body_kernel import shifted_rotors

        one = self._stretches[stretch]
        squares = self._rotors(id(one.run), stretch, key)
        period = one.run.period_s
        mean, spin, up = np.empty((len(one), 4)), np.empty(len(one)), np.empty(len(one))
        shifted_rotors(
            *(squares.square, squares.end, one.first, delay_s / period, period, mean, spin, up)
        )
        return _Late(mean, REVOLUTION * spin, REVOLUTION * up)

    def _velocity(self, stretch: int) -> Array:
        """Forward and left velocity (n, 2) in m/s, integrated from tilt with a leak.

        The rotors push along z only, so what moves the craft sideways is gravity; the slow part,
        which the leak takes away, is left to the noise model.
        """
        from scipy.signal import lfilter

        one = self._stretches[stretch]
        if not np.isfinite(one.run.attitude).all():
            raise BadInputError(
                f"{one.run.name}: velocity_moment needs the attitude, which is not in every row"
            )
        keep = math.exp(-one.run.period_s / LEAK_S)
        tilt = STANDARD_GRAVITY * np.sin(one.run.attitude[:, 1::-1]) * [1.0, -1.0]
        speed = lfilter([one.run.period_s], [1.0, -keep], tilt, axis=0)
        return np.asarray(speed[one.first - 1 : one.last - 1])


@dataclass(frozen=True, slots=True)
class _Late:
    """What acted over each row's period, as late as the outputs show it.

    squares: (n, 4) mean (rev/s)^2. spin: (n,) rotor sum of eq. 3.50 in rad/s. spin_up: its slope.
    """

    squares: Array
    spin: Array
    spin_up: Array


def measured_acceleration(stretch: Stretch) -> Array:
    """Steps of the gyro over each row's period, divided by it: (n, 3) rad/s^2."""
    run = stretch.run
    return np.asarray(np.diff(run.gyro[stretch.first - 1 : stretch.last], axis=0) / run.period_s)


def _turned(values: Mapping[str, float]) -> Array:
    """Rz Ry Rx of the sensor in the body: body rows times this are the sensor's."""
    from groundstation.dynamics.rotations import rotation_matrix

    angles = [math.radians(values[f"imu_misalignment.{axis}_deg"]) for axis in _AXES]
    return np.asarray(rotation_matrix(angles))


_AXES = ("roll", "pitch", "yaw")


def _lagged(acceleration: Array, lag_s: float, period_s: float) -> Array:
    """First-order lag of rates that move linearly within each row; settled at the first."""
    from scipy.signal import lfilter

    keep = math.exp(-period_s / lag_s)
    early = (1.0 - keep) * lag_s / period_s
    start = (early - keep) * acceleration[:1] + keep * acceleration[:1]
    out, _ = lfilter([1.0 - early, early - keep], [1.0, -keep], acceleration, axis=0, zi=start)
    return np.asarray(out)
