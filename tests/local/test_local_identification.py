"""Identification on real flights that are not part of the repository: `make check-local`.

imrc/eckart*: a craft of another kind (X configuration, 37 g) with measured rotor speeds.
"""

import os
from pathlib import Path

import pytest

from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.body import fit_body
from groundstation.identification.body_validation import validate_body
from groundstation.identification.motor import fit_motor, measured_run, validate_motor
from groundstation.identification.runs import hold_out, runs_of
from groundstation.identification.stretches import split, stretches_of
from groundstation.recording.open_recording import open_recording

DATA = os.environ.get("GROUNDSTATION_LOCAL_DATA")
pytestmark = pytest.mark.skipif(
    DATA is None or not Path(DATA).is_dir(),
    reason="GROUNDSTATION_LOCAL_DATA names no folder with usd_card/ and imrc/",
)
FLIGHTS = ("00", "12", "22", "27", "34")


@pytest.fixture(scope="module")
def flights():
    """The runs of all flights."""
    runs = []
    for number in FLIGHTS:
        samples = open_recording(Path(DATA) / "imrc" / f"eckart{number}").samples
        runs += runs_of(samples, f"eckart{number}")
    return runs


@pytest.mark.parametrize("motor", range(4))
def test_pwm_and_battery_explain_measured_rotor_speed(flights, motor):
    halves = [hold_out([run]) for run in flights]
    fit = fit_motor([measured_run(run, motor) for one, _ in halves for run in one])
    assert 0.002 < fit.estimates["delay_s"] < 0.008
    errors = []
    for run in [run for _, held in halves for run in held]:
        _, error = validate_motor(measured_run(run, motor), fit.motor, fit.estimates["delay_s"])
        errors.append(error)
    print(f"M{motor + 1}: held-out RMS {', '.join(f'{e:.2f}' for e in errors)} rev/s")
    assert max(errors) < 2.0


@pytest.mark.parametrize("measured", [True, False], ids=["measured speed", "modelled speed"])
def test_a_body_is_found_with_and_without_measured_rotor_speed(flights, measured):
    vehicle = BUILT_IN["crazyflie21"]
    motor = fit_motor([measured_run(run, k) for run in flights for k in range(4)]).motor
    fit_on, held = split(stretches_of(flights, motor, measured))
    fit = fit_body(fit_on, vehicle, ("dead_time",))
    figures = validate_body(held, fit)
    print(fit.body, f"delay {fit.delay_s * 1e3:.2f} ms", figures)
    assert min(fit.body.c0, fit.body.c1, fit.body.c2) > 0
    assert 0.001 < fit.delay_s < 0.006
    assert figures["accelerometer_z_fit_percent"] > 60
    assert figures["gyro_roll_rms_1row"] < 0.1
