"""What is known before a flight is looked at: the motors, the filter's timing, a flight's trim."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import Model
from groundstation.dynamics.registry import DELAY, SPIN_UP
from groundstation.dynamics.vehicle import Vehicle
from groundstation.identification.likelihood.parameters import (
    KEYS,
    MOTOR_KEYS,
    SENSOR_LAG,
    TIMING,
    Point,
    point_of,
)
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]
Prior = tuple[tuple[str, ...], dict[str, float], Array]

MOTOR_DOUBT, LEAST_MOTOR_DOUBT = 0.02, 0.001
"""Relative standard error of a0, a1, a2 where the model does not say, and the least believed."""
TIMING_DOUBT = 0.5
LAG_DOUBT_S = 0.01
"""Of measured rotor speeds: a sensor that averages over revolutions, and a log that holds them."""
TRIM_SHARE = 0.03
"""Of one rotor's moment in hover: the lasting moment that flights of one craft differ by. It is a
battery pushed in a millimetre elsewhere, a propeller changed."""


def trim_of(vehicle: Vehicle) -> tuple[float, float, float]:
    """Standard deviation of a flight's lasting moment about each axis, rad/s^2."""
    square = STANDARD_GRAVITY / (4.0 * vehicle.thrust_per_mass)
    roll, pitch, yaw = (TRIM_SHARE * abs(one) * square for one in vehicle.body_constants)
    return roll, pitch, yaw


def sensor_lag(model: Model) -> float:
    """Of measured rotor speeds in s, as the motors' fit found it; 0 where it did not. A model that
    has the effect says it itself."""
    account = model.fit.get("motor", {}).get("estimates") or {}
    known = dict(zip(account.get("names", ()), account.get("values", ()), strict=False))
    return float(np.clip(known.get("sensor_lag_s", 0.0), *KEYS[SENSOR_LAG].bounds))


def fitted_along(model: Model) -> Point:
    """How late the rotors' answer is and what they take to speed up, as the body's fit found it.

    They and the lag of the rotors' sensor multiply each other: from nothing each of them alone
    leads astray. What counts of delay and lag is their difference.
    """
    along = model.fit.get("body", {}).get("fitted_along") or {}
    found = {key: along[key]["value"] for key in (DELAY, SPIN_UP, SENSOR_LAG) if key in along}
    if DELAY in found and SENSOR_LAG in found:
        lag = point_of(model).get(SENSOR_LAG, found[SENSOR_LAG])
        found[DELAY] += lag - found[SENSOR_LAG]
    return found


def prior_of(model: Model, start: Point) -> tuple[list[Prior], bool]:
    """The bench's a0, a1, a2 with their covariance, and the attitude filter's timing.

    A constant that is zero (a2 of a first-order motor) stays so: it is not in the prior.
    """
    motor = tuple(key for key in MOTOR_KEYS if start[key] != 0.0)
    centre = {key: start[key] for key in motor}
    values = np.array([start[key] for key in motor])
    covariance, known = np.diag((MOTOR_DOUBT * values) ** 2), False
    account = model.fit.get("motor", {}).get("estimates")
    if account and set(motor) <= set(account.get("names", ())):
        at = [account["names"].index(key) for key in motor]
        given = np.array(account["covariance"], np.float64)[np.ix_(at, at)]
        if np.isfinite(given).all():
            covariance, known = given + np.diag((LEAST_MOTOR_DOUBT * values) ** 2), True
    weight = np.asarray(np.linalg.inv(covariance))
    timing = ((TIMING,), {TIMING: 0.0}, np.array([[TIMING_DOUBT**-2]]))
    return [(motor, centre, weight), timing], known
