"""The low-pass that today's firmware puts behind the accelerometer."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, freqz
from stand_in_flights import CARRYING_GAINS, recorded

from groundstation.discrepancy.screening import screen
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.frame import Frame
from groundstation.identification.likelihood.parameters import point_of
from groundstation.identification.likelihood.problem import Problem
from groundstation.identification.likelihood.residuals import FORCES
from groundstation.identification.likelihood.sensing import Moving, Sensors
from groundstation.identification.recordings import flights_of

VEHICLE = BUILT_IN["crazyflie21"]
MODEL = vehicle_model(VEHICLE)
CORNER_HZ, DRAG = 30.0, 0.012


@pytest.fixture(scope="module")
def flights():
    """One flight of today's craft, its rotors dragged by the air."""
    effects = {"rotor_drag": {"drag_n_s_m": DRAG}}
    chosen = {"plant": "faithful", "gains": CARRYING_GAINS, "effects": effects}
    samples, _ = recorded(20.0, seed=3, craft="crazyflie21", **chosen)
    return prepare(flights_of(samples, "flight"))


@pytest.mark.parametrize(
    ("hz", "period_s"), [(3.0, 0.001), (20.0, 0.001), (3.0, 0.002), (20.0, 0.002), (3.0, 0.01)]
)
def test_a_force_in_the_plane_passes_as_behind_the_filter_at_its_own_rate(hz, period_s):
    craft = Frame(VEHICLE).craft(point_of(MODEL))
    sensors = Sensors((), craft, (0.0, CORNER_HZ))
    time = period_s * np.arange(round(2.0 / period_s))
    force = np.exp(2j * np.pi * hz * time)[:, None] * np.ones(3)
    moving = Moving.__new__(Moving)
    moving.period_s = period_s
    shown = sensors.answer(force.real, FORCES, moving) + 1j * sensors.answer(
        force.imag, FORCES, moving
    )
    _, gain = freqz(*butter(2, CORNER_HZ, fs=1000.0), worN=[hz], fs=1000.0)
    assert np.abs(shown[-100:, :2] / force[-100:, :2] - gain).max() < 0.03
    assert (shown[:, 2] == force[:, 2]).all()


def test_drag_is_right_behind_the_filter_and_lost_without_it(flights):
    problem = Problem(flights, MODEL, point_of(MODEL))
    problem.settle_filters()
    found, error = drag(problem)  # the quiet rows above the corner outweigh all motion
    assert found < 0.5 * DRAG
    other = Problem(flights, MODEL, point_of(MODEL))
    other.frame = replace(problem.frame, accelerometer_filter_hz=VEHICLE.accelerometer_filter_hz)
    found, error = drag(other)
    assert abs(found - DRAG) < 3.0 * error < 0.1 * DRAG


def drag(problem):
    """What all effects at once say of it."""
    seen = screen(problem, problem.start)
    (one,) = seen.beside_all([problem.frame.variants["rotor_drag.drag_n_s_m"]])
    return float(one.values[0]), float(one.errors[0])
