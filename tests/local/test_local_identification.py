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


@pytest.fixture(scope="module")
def motor(flights):
    return fit_motor([measured_run(run, k) for run in flights for k in range(4)])


@pytest.mark.parametrize("measured", [True, False], ids=["measured speed", "modelled speed"])
def test_a_body_is_found_with_and_without_measured_rotor_speed(flights, motor, measured):
    """What turns this craft beside its rotors' thrust and drag: their acceleration on yaw, and a
    moment in proportion to speed, the largest effect of all."""
    vehicle = BUILT_IN["crazyflie21"]
    fit_on, held = split(stretches_of(flights, motor.motor, measured))
    base, more = (
        fit_body(fit_on, vehicle, effects, motor_covariance=motor.estimates.covariance[:3, :3])
        for effects in (
            ("dead_time",),
            ("dead_time", "rotor_acceleration_torque", "velocity_moment"),
        )
    )
    before, after = validate_body(held, base), validate_body(held, more)
    for axis in ("roll", "pitch", "yaw"):
        name = f"gyro_{axis}_rms_20ms"
        print(f"{name}: {before[name]:.4f}, with the effects {after[name]:.4f} rad/s")
        assert after[name] < 0.8 * before[name]
    for fit in (base, more):
        print(dict(zip(fit.estimates.names, fit.estimates.values.tolist(), strict=True)))
        assert min(fit.body.c0, fit.body.c1, fit.body.c2) > 0
    assert 0.001 < more.delay_s < 0.012
    assert more.values["rotor_acceleration_torque.rotor_inertia_kg_m2"] == pytest.approx(
        4e-8, rel=0.3
    )
    assert 25 < more.values["velocity_moment.moment"] < 40
    assert after["accelerometer_z_fit_percent"] > 60
