"""The whole simulation of the thesis's Figure 8.10, against its blocks one by one."""

import numpy as np
import pytest

from groundstation.control.firmware_loop import plant_of_model
from groundstation.control.firmwares import PidGains
from groundstation.control.linear_loop import (
    axis_plant,
    counts_per_control,
    run_direct,
    run_whole,
    whole_loop,
)
from groundstation.dynamics.model import THESIS, Model, simulate_arx
from groundstation.dynamics.simulation import simulate_motor
from groundstation.errors import BadInputError
from support.equations import distribute, mix, output_stage

TS = 0.002
BODY_ONLY = Model(vehicle="crazyflie1", motor=THESIS.motor, body=THESIS.body)
GAINS = [PidGains(2000.0, 400.0, 350.0), PidGains(2000.0, 400.0, 350.0), PidGains(4000.0, 0, 900.0)]


def steps(size=0.1, rows=400):
    reference = np.zeros((rows, 3))
    reference[50:, 0], reference[120:, 1], reference[200:, 2] = size, -size, 2 * size
    return reference


def test_its_blocks_are_those_of_the_dynamics_package():
    """PWM to voltages to rotors to u' to ARX, each by the package's own function."""
    response = run_whole(THESIS, GAINS, steps(), delay=2)
    thrust = response.pwm[0].mean()
    np.testing.assert_allclose(
        response.pwm, distribute(np.full(400, thrust), response.controls), atol=1e-9
    )
    volts = output_stage(response.pwm, np.full(400, 3700.0))
    hover = np.sqrt(9.80665 / (4 * THESIS.body.thrust_per_mass))
    speed, _ = simulate_motor(THESIS.motor, volts, TS, np.full(4, hover), substeps=1)
    torque = mix(speed[:-1])
    for index, axis in enumerate(("roll", "pitch", "yaw")):
        expected = simulate_arx(axis_plant(THESIS, axis, 2), torque[:, index])
        np.testing.assert_allclose(response.angles[:, index], expected, atol=1e-9)


def test_the_printed_gains_saturate_it_at_once():
    """They act on u': with +-4096 counts there is nothing between the stops."""
    gains = [PidGains(1530000.0, 0.0, 10200.0)] * 3
    controls = run_whole(THESIS, gains, steps(), delay=2).controls
    assert (np.abs(controls[60:, 0]) == 4096).mean() > 0.9


def test_a_delay_is_whole_samples_between_body_and_controller():
    reference = steps(0.05, 90)
    prompt, late = (run_whole(BODY_ONLY, GAINS, reference, delay=rows) for rows in (0, 5))
    moved = [int(np.flatnonzero(r.angles[:, 0])[0]) for r in (prompt, late)]
    assert moved[1] - moved[0] == 5


def test_slow_motors_apart_it_is_the_direct_loop():
    """With motors a hundred times faster and gains converted, u' follows at once."""
    quick = Model(
        vehicle="crazyflie1",
        motor=THESIS.motor.__class__(86.2446, 681.4507, 0.0),
        arx=THESIS.arx,
    )
    plant = axis_plant(THESIS, "roll", 3)
    gains = PidGains(3e5, 1e5, 8e3)
    counts = counts_per_control(quick)[0]
    scaled = PidGains(*(counts * g for g in gains.as_tuple()))
    reference = np.zeros((600, 3))
    reference[:, 0] = 1e-3
    whole = run_whole(quick, [scaled, PidGains(0.0), PidGains(0.0)], reference, delay=2)
    direct = run_direct(plant, gains, reference[:, 0])
    assert np.abs(whole.angles[:, 0] - direct).max() < 0.1e-3


def test_its_margin_is_the_delay_it_bears():
    gains = PidGains(100.0, 0.0, 30.0)
    margin = whole_loop(BODY_ONLY, gains, "roll", delay=2).margins.delay_s
    reference = np.zeros((4000, 3))
    reference[:, 0] = 0.001

    def grows(samples):
        three = [gains, PidGains(0.0), PidGains(0.0)]
        y = run_whole(BODY_ONLY, three, reference, delay=2 + samples).angles[:, 0]
        return np.ptp(y[-1000:]) > np.ptp(y[-2000:-1000])

    assert not grows(int(0.85 * margin / TS))
    assert grows(int(1.15 * margin / TS) + 1)


def test_a_model_without_a_body_is_refused():
    only_arx = Model(vehicle="crazyflie1", motor=THESIS.motor, arx=THESIS.arx)
    with pytest.raises(BadInputError, match="no body constants"):
        plant_of_model(only_arx)
    only_roll = Model(vehicle="crazyflie1", motor=THESIS.motor, arx={"roll": THESIS.arx["roll"]})
    with pytest.raises(BadInputError, match="no ARX polynomials for roll, pitch and yaw"):
        run_whole(only_roll, GAINS, steps())
