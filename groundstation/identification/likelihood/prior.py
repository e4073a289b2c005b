"""What is known before a flight is looked at: the given model's constants, the motors, the filter's
timing, a flight's trim."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.dynamics.model import Model
from groundstation.dynamics.registry import DELAY, SPIN_UP
from groundstation.dynamics.vehicle import Vehicle
from groundstation.identification.likelihood.parameters import (
    BODY_KEYS,
    KEYS,
    MOTOR_KEYS,
    SENSOR_LAG,
    TIMING,
    Point,
    point_of,
)
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

MOTOR_DOUBT, LEAST_MOTOR_DOUBT = 0.02, 0.001
"""Relative standard error of a0, a1, a2 where the model does not say, and the least believed."""
BODY_DOUBT = 0.03
"""Relative standard deviation of c0, c1, c2 and thrust per mass, added to what the model states:
what flights of one craft differ by."""
TAIL = 10.0
"""A model that was fitted to flights with something missing may be off by half: its prior has the
tail of Student's distribution, and weighs an eleventh at 10 standard deviations. So has that of
motors whose pace such a fit took from flights."""
TIMING_DOUBT = 0.5
LAG_DOUBT_S = 0.01
"""Of measured rotor speeds: a sensor that averages over revolutions, and a log that holds them."""
TRIM_SHARE = 0.03
"""Of one rotor's moment in hover: the lasting moment that flights of one craft differ by. It is a
battery pushed in a millimetre elsewhere, a propeller changed."""


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of some unknowns p: it adds tail * log(1 + d / tail) to -2 log L, where d =
    (p - centre)' weight (p - centre); of a normal distribution, without a tail, d."""

    keys: tuple[str, ...]
    centre: dict[str, float]
    weight: Array
    tail: float = math.inf

    def at(self, point: Mapping[str, float]) -> tuple[Array, Array, float]:
        """(normal matrix (k, k), gradient (k,), value) around a point."""
        away = np.array([self.centre[key] - point[key] for key in self.keys])
        square = float(away @ self.weight @ away)
        if math.isinf(self.tail):
            return self.weight, self.weight @ away, square
        weight = self.weight / (1.0 + square / self.tail)
        return weight, weight @ away, self.tail * math.log1p(square / self.tail)


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


def body_prior(model: Model, start: Point) -> Prior:
    """The given c0, c1, c2 and thrust per mass, with their stated covariance and ``BODY_DOUBT``."""
    values = np.array([start[key] for key in BODY_KEYS])
    covariance = np.diag((BODY_DOUBT * values) ** 2)
    account = model.fit.get("body", {}).get("estimates") or {}
    if set(BODY_KEYS) <= set(account.get("names", ())):
        at = [account["names"].index(key) for key in BODY_KEYS]
        stated = np.array(account["covariance"], np.float64)[np.ix_(at, at)]
        if np.isfinite(stated).all():
            covariance = covariance + stated
    centre = {key: start[key] for key in BODY_KEYS}
    return Prior(BODY_KEYS, centre, np.asarray(np.linalg.inv(covariance)), TAIL)


def prior_of(model: Model, start: Point, told: bool) -> tuple[list[Prior], bool]:
    """The bench's a0, a1, a2 with their covariance, or those of a model without one, and the
    attitude filter's timing; whether there was a bench.

    told: rows show every setting of the motors. Where they do not, no likelihood tells how fast
    rotors answer, and the model's numbers have no tail. Nor have a profile's, which no flight bent.
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
    pace = model.fit.get("body", {}).get("motor_pace", {}).get("value", 1.0)
    tail = TAIL if told and not known and pace != 1.0 else math.inf
    timing = Prior((TIMING,), {TIMING: 0.0}, np.array([[TIMING_DOUBT**-2]]))
    return [Prior(motor, centre, weight, tail), timing], known
