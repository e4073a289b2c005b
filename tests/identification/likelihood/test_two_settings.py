"""Rows half as fast as the motors are set, which tell both settings: when a torque acted within a
row shows behind the filter of the gyro."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.model import EffectTerm, Estimate, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.evaluation import evaluate
from groundstation.identification.likelihood.motion import Frame, point_of, spin_rotors
from groundstation.identification.runs import flights_of
from support.flights import CARRYING_GAINS, recorded, truth_of

PROGRAMME = Path(__file__).parents[3] / "bench" / "sealed" / "programme.toml"
VEHICLE = BUILT_IN["crazyflie21"]
INERTIA = "rotor_acceleration_torque.rotor_inertia_kg_m2"
GAINS = {**CARRYING_GAINS, "pid_rate.roll_kp": 125.0, "pid_rate.pitch_kp": 125.0}
YAW, INERTIA_KG_M2 = 2, 1e-7
MODEL = msgspec.structs.replace(
    vehicle_model(VEHICLE),
    effects=(
        EffectTerm("gyro_filter", {"corner_hz": Estimate(80.0)}),
        EffectTerm("rotor_acceleration_torque", {"rotor_inertia_kg_m2": Estimate(INERTIA_KG_M2)}),
    ),
)


@pytest.fixture(scope="module")
def slow():
    """Every second row of a noiseless flight that turns about every axis."""
    effects = {"rotor_acceleration_torque": {"rotor_inertia_kg_m2": INERTIA_KG_M2}}
    quiet = {"plant": "reduced", "torque_noise": 0.0, "sensor_noise": 0.0, "gains": GAINS}
    flown = {"craft": "crazyflie21", "program": str(PROGRAMME), "effects": effects}
    samples, _ = recorded(40.0, seed=3, **quiet, **flown)
    return every_second(samples)


def every_second(samples):
    """Rows half as fast, each with the setting of the row before it and its own."""
    first, second = samples.duty[1:-1:2], samples.duty[2::2]
    both = {"duty": 0.5 * (first + second), "duty_step": second - first}
    return replace(samples[2::2], **both)


def inertia_off(samples):
    """By what share these rows would move the rotors' inertia away from the true one."""
    (flight,) = prepare(flights_of(samples, "flight"))
    series = evaluate(flight, Frame(VEHICLE), point_of(MODEL), (INERTIA, "c2"))
    columns = np.column_stack([series.columns[key][YAW] for key in (INERTIA, "c2")])
    change = np.linalg.lstsq(columns, series.residual[YAW], rcond=None)[0]
    return abs(change[0]) / INERTIA_KG_M2


def test_the_rotors_inertia_is_right_where_rows_tell_both_settings(slow):
    untold = replace(slow, duty_step=np.full_like(slow.duty_step, np.nan))
    assert np.abs(slow.duty_step).mean() > 0.01  # they alternate
    assert inertia_off(slow) < 0.005
    assert inertia_off(untold) > 0.007


def test_rotors_turn_as_they_did_behind_a_report_that_lags():
    """Under a row's first setting the voltage was another, which a report that lags does not show;
    rev/s of 290 on average. With the same voltage under both settings and the current of their
    mean it would be 0.25."""
    lag = {"battery_reading_lag": {"time_constant_s": 0.2}}
    flight_of = {"craft": "brushless", "plant": "reduced", "program": str(PROGRAMME)}
    samples, truth = recorded(40.0, seed=5, gains=GAINS, effects=lag, **flight_of)
    turned = truth_of(samples, truth)["rotor_rev_s"][2::2]
    (flight,) = prepare(flights_of(every_second(samples), "flight"))
    terms = (EffectTerm("battery_reading_lag", {"time_constant_s": Estimate(0.2)}),)
    vehicle = BUILT_IN["brushless"]
    model = msgspec.structs.replace(vehicle_model(vehicle), effects=terms)
    found = spin_rotors(flight, point_of(model), Frame(vehicle)).end
    error = (found - turned[-len(found) :])[2000:-500]
    assert np.abs(turned).max() > 100.0
    assert np.sqrt(np.mean(error**2)) < 0.1
