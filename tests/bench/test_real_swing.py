"""The swing of a load, found in flights that were made with a linear pendulum."""

import numpy as np
import pytest

from bench.real.swing import Flown, find_swing
from groundstation.telemetry.packet import STANDARD_GRAVITY

PERIOD_S, ROWS = 0.004, 5000
LENGTH_M, DAMPING, SHARE, DRAG = 0.45, 0.4, 0.12, 0.35


def flight(seed, share):
    """20 s of small motion; the velocity is the one with which drag and load make the force."""
    rng = np.random.default_rng(seed)
    hz = np.fft.rfftfreq(ROWS, PERIOD_S)
    turn = 2j * np.pi * hz
    force = rng.standard_normal(len(hz)) * np.exp(2j * np.pi * rng.random(len(hz)))
    force[(hz < 0.3) | (hz > 3.0)] = 0.0
    line = -force / LENGTH_M / (turn**2 + DAMPING * turn + STANDARD_GRAVITY / LENGTH_M)
    moving = (share * STANDARD_GRAVITY * line - force) / DRAG
    force, moving = (np.fft.irfft(one, ROWS)[:, None] for one in (force, moving))
    scale = 0.3 / force.std()
    up, still = np.full((ROWS, 1), STANDARD_GRAVITY), np.zeros((ROWS, 1))
    return Flown(
        PERIOD_S,
        np.tile(np.eye(3), (ROWS, 1, 1)),
        np.hstack([scale * moving, still, still]),
        np.hstack([scale * force, still, up]),
    )


def test_length_damping_and_mass_are_found():
    found = find_swing([flight(1, SHARE), flight(2, SHARE)], [flight(3, SHARE)], 0)
    assert found.length_m == pytest.approx(LENGTH_M, rel=0.05)
    assert found.gains == pytest.approx([-DRAG, SHARE], rel=0.15)
    assert 1.0 - found.explained < 0.1 * (1.0 - found.plain)


def test_where_nothing_hangs_a_swing_explains_nothing():
    found = find_swing([flight(1, 0.0), flight(2, 0.0)], [flight(3, 0.0)], 0)
    assert abs(found.gains[1]) < 0.01
    assert found.plain > 0.99
