"""Body velocity, which no sensor measures, from specific force and attitude: a leaky integral."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.airborne import flights_in
from groundstation.identification.flight import Flight
from groundstation.identification.runs import Run
from groundstation.prediction.start_velocity import start_velocity
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]

REST = np.zeros(3)
LEAK_S, LEANING_LEAK_S = 16.0, 4.0
"""Velocity is known over times shorter than this, with an attitude that is right; with one that
leans towards the accelerometer, as on-board estimates do, or is carried by the gyro instead."""


def velocity_from(
    attitude: Array,
    force: Array,
    period_s: float,
    leak_s: float,
    first: int = 0,
    start: Array = REST,
) -> Array:
    """Velocity (n, 3) in m/s, forward, left, up, from attitude (n, 3) and specific force (n, 3).

    At each row what the rows before tell, from row ``first`` on, where the inertial velocity is
    ``start`` (3,) (``prediction/start_velocity.py``). Steady speed, and what an offset
    of the sensors would add, are forgotten (two leaks of time constant ``leak_s``).
    """
    from groundstation.identification.likelihood.kernels import body_velocity

    attitude, force = (np.ascontiguousarray(one, np.float64) for one in (attitude, force))
    velocity = np.zeros_like(attitude)
    body_velocity(attitude, force, STANDARD_GRAVITY, period_s, leak_s, first, start, velocity)
    return velocity


def velocity_in(flight: Flight, attitude: Array, force: Array, leak_s: float) -> Array:
    """Velocity (n, 3) m/s in a flight: from rest where it began on the ground, or else with what
    its first seconds tell."""
    start, rows = REST, flight.rows
    if not flight.rests[0]:
        start = start_velocity(attitude[rows], force[rows], flight.period_s)
    first = flight.whole.start
    return velocity_from(attitude, force, flight.period_s, leak_s, first, start)


def velocity_of(run: Run, leak_s: float = LEANING_LEAK_S) -> Array:
    """Velocity (n, 3) m/s of a run as recorded; zero without accelerometer or attitude."""
    attitude, force = run.attitude, run.accelerometer
    if not (np.isfinite(force).all() and np.isfinite(attitude).all()):
        return np.zeros((len(run), 3))
    start, flights = REST, flights_in(run)
    if flights and flights[0].start == 0 and not flights[0].rests[0]:
        rows = slice(0, flights[0].stop)
        start = start_velocity(attitude[rows], force[rows], run.period_s)
    return velocity_from(attitude, force, run.period_s, leak_s, 0, start)
