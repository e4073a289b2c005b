"""The rotor speeds behind a flight, as every stage of identification takes them."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.dynamics.model import vehicle_model, with_motor
from groundstation.dynamics.vehicle import BUILT_IN, MotorConstants, mean_motor
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.frame import Frame
from groundstation.identification.likelihood.parameters import point_of
from groundstation.identification.likelihood.rotors import spin_rotors
from groundstation.identification.runs import Run
from groundstation.identification.torque import rotor_squares

ROWS = 2500
FOUR = tuple(MotorConstants(1.2 + 0.1 * i, 9.0 + i, 0.004 * i) for i in range(4))
VEHICLE = BUILT_IN["crazyflie21"]


@pytest.fixture(scope="module")
def run():
    generator = np.random.default_rng(2)
    missing = np.full((ROWS, 3), np.nan)
    return Run(
        "hover",
        0.0,
        0.002,
        duty=0.6 + 0.05 * np.sin(np.arange(4) + np.arange(ROWS)[:, None] / 60.0),
        supply_v=np.full(ROWS, 3.9),
        gyro=generator.normal(0.0, 0.01, (ROWS, 3)),
        accelerometer=missing,
        attitude=missing,
        rotor_rev_s=np.full((ROWS, 4), np.nan),
        debug_s=np.zeros(ROWS),
    )


@pytest.mark.parametrize(
    "key", [None, "motor_dead_voltage.voltage_mv", "motor_braking_asymmetry.factor"]
)
def test_each_rotor_turns_by_its_own_motor_in_the_fit_as_in_the_search(run, key):
    (flight,) = prepare([run])
    mean = mean_motor(FOUR)
    point = point_of(with_motor(vehicle_model(VEHICLE), mean))
    size = {None: {}, "motor_dead_voltage.voltage_mv": {"dead_mv": 120.0}}.get(
        key, {"braking": 0.7}
    )
    point.update(zip([key], size.values(), strict=False))
    late = slice(ROWS // 2, None)  # the start is settled at a voltage that each takes differently
    search = spin_rotors(flight, point, Frame(VEHICLE, FOUR)).square[late]
    fit = rotor_squares(run, FOUR, **size).square[late]
    apart = np.ptp(fit.mean(axis=0))
    assert apart > 2000.0
    np.testing.assert_allclose(search, fit, rtol=1e-8)
    alike = spin_rotors(flight, point, Frame(VEHICLE)).square[late].mean(axis=0)
    assert np.ptp(alike) < 0.1 * apart
