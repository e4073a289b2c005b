"""Body velocity, which no sensor measures, from specific force and attitude: a leaky integral."""

from __future__ import annotations

import numpy as np

from groundstation.identification.airborne import flights_in
from groundstation.identification.flight import Flight, quaternion_rows
from groundstation.identification.runs import Run
from groundstation.prediction.prediction import start_velocity
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

LEAK_S, LEANING_LEAK_S = 16.0, 4.0
"""Velocity is known over times shorter than this, with an attitude that is right; with one that
leans towards the accelerometer, as on-board estimates do, or is carried by the gyro instead."""


def velocity_in(
    flight: Flight, attitude: Array, orientation: Array, force: Array, leak_s: float
) -> Array:
    """Velocity (n, 3) m/s in a flight: from rest where it began on the ground, or else with what
    its first seconds tell. orientation: (4, n), the quaternions of ``attitude`` (n, 3)."""
    moving = slice(0) if flight.rests[0] else flight.rows
    start = start_velocity(attitude[moving], force[moving], flight.period_s)
    return _velocity(orientation, force, flight.period_s, leak_s, flight.whole.start, start)


def velocity_of(run: Run, leak_s: float = LEANING_LEAK_S) -> Array:
    """Velocity (n, 3) m/s of a run as recorded; zero without accelerometer or attitude."""
    attitude, force = run.attitude, run.accelerometer
    if not (np.isfinite(force).all() and np.isfinite(attitude).all()):
        return np.zeros((len(run), 3))
    flights = flights_in(run)
    moving = slice(flights[0].stop if flights and flights[0].start == 0 else 0)
    start = start_velocity(attitude[moving], force[moving], run.period_s)
    return _velocity(quaternion_rows(attitude), force, run.period_s, leak_s, 0, start)


def _velocity(
    orientation: Array, force: Array, period_s: float, leak_s: float, first: int, start: Array
) -> Array:
    """Velocity (n, 3) in m/s, forward, left, up, from quaternions (4, n) and specific force (n, 3).

    At each row what the rows before tell, from row ``first`` on. start: inertial velocity (3,)
    there (``prediction/start_velocity.py``). Steady speed, and what an offset of the sensors would
    add, are forgotten (two leaks of time constant ``leak_s``).
    """
    from groundstation.identification.likelihood.kernels import body_velocity

    force = np.ascontiguousarray(force, np.float64)
    velocity = np.zeros_like(force)
    body_velocity(orientation, force, STANDARD_GRAVITY, period_s, leak_s, first, start, velocity)
    return velocity
