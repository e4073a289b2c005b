"""The low-pass that today's firmware puts behind the accelerometer."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.signal import butter, freqz

from groundstation.discrepancy.engine import find_discrepancy
from groundstation.discrepancy.screening import screen
from groundstation.dynamics.model import EffectTerm, Estimate, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.body import identify_body
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import Frame, point_of
from groundstation.identification.likelihood.problem import Problem, filters_of
from groundstation.identification.likelihood.sensing import FORCES, Moving, Sensors
from groundstation.identification.runs import flights_of, runs_of
from groundstation.prediction.prediction import predict_ahead
from support.flights import CARRYING_GAINS, recorded

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


def test_where_rotor_speeds_were_recorded_the_gyros_filter_alone_is_told(flights):
    assert filters_of(VEHICLE, flights) == {"gyro_filter": 80.0, "accelerometer_filter": 30.0}
    speeds = [np.full((len(one.run.gyro), 4), 250.0) for one in flights]
    recorded_too = [
        replace(one, run=replace(one.run, rotor_rev_s=rev_s))
        for one, rev_s in zip(flights, speeds, strict=True)
    ]
    assert filters_of(VEHICLE, recorded_too) == {"gyro_filter": 80.0}


@pytest.mark.parametrize(("name", "late_s"), [("gyro_filter", 0.0), ("gyro_low_pass", 0.005)])
def test_reported_angles_turn_by_what_the_firmware_filtered(name, late_s):
    """They share the on-board filter's lag; a gyro that is slow itself lags behind them."""
    values = {"gyro_filter": {"corner_hz": 80.0}, "gyro_low_pass": {"bandwidth_hz": 100 / np.pi}}
    terms = {key: Estimate(value) for key, value in values[name].items()}
    model = msgspec.structs.replace(MODEL, effects=(EffectTerm(name, terms),))
    point = point_of(model)
    frame = Frame(VEHICLE)
    acting = tuple(one for one in frame.acting(point).values() if one is not None)
    sensors = Sensors(acting, frame.craft(point))
    gyro, slope = np.array([[1.0, -2.0, 0.5]]), np.array([[30.0, 10.0, -20.0]])
    np.testing.assert_allclose(sensors.turning(gyro, slope, 1.0), gyro + late_s * slope, atol=1e-6)
    assert sensors.gyro_lag[0, 0] > 0.002


def test_angles_of_todays_craft_are_predicted_as_its_estimator_reports_them():
    """In still air within what a packet can tell apart, 0.01 deg; true angles, which are
    2.8 ms earlier, would be far off."""
    quiet = {"plant": "reduced", "torque_noise": 0.0, "sensor_noise": 0.0}
    (run,) = runs_of(recorded(15.0, seed=3, craft="crazyflie21", **quiet)[0])
    filtered = EffectTerm("gyro_filter", {"corner_hz": Estimate(80.0)})
    model = msgspec.structs.replace(MODEL, effects=(filtered,))
    early = replace(run, attitude=run.attitude + 2.8e-3 * run.gyro)
    off, early_off = (
        np.degrees(np.sqrt(np.mean(predict_ahead(model, one, [25]).errors(one)[..., 6] ** 2)))
        for one in (run, early)
    )
    assert off < 0.01
    assert early_off > 10.0 * off


def drag(problem):
    """What all effects at once say of it."""
    seen = screen(problem, problem.start)
    (one,) = seen.beside_all([problem.frame.variants["rotor_drag.drag_n_s_m"]])
    return float(one.values[0]), float(one.errors[0])


@pytest.fixture(scope="module")
def clean():
    """Three flights of today's craft in which nothing acts but the base model."""
    chosen = {"plant": "reduced", "craft": "crazyflie21"}
    return [recorded(24.0, seed=seed, **chosen)[0] for seed in (21, 22, 23)]


def every_other(samples):
    """Every other row, with the mean of the two settings that acted since the one before."""
    acted = samples.duty[2:], samples.duty[1:-1]
    return replace(samples[2:], duty=np.mean(acted, axis=0, dtype=np.float32))[::2]


def test_a_clean_flight_of_todays_craft_is_explained_and_nothing_is_named(clean):
    """Without the filters: a dead time, a sag and a damping, and a third less thrust per mass."""
    first, second, held = map(every_other, clean)
    runs = [run for one in (first, second) for run in runs_of(one, "flight")]
    model = identify_body(runs, [], MODEL, VEHICLE).model
    corners = {term.name: term.parameters["corner_hz"].value for term in model.effects}
    assert corners == {"gyro_filter": 80.0, "accelerometer_filter": 30.0}
    found = find_discrepancy(
        [flights_of(first, "a"), flights_of(second, "b")], model, [flights_of(held, "c")]
    )
    assert found.findings.effects == ()
    assert found.proof.after.gap < 1.15
    for key in ("c0", "c1", "c2", "thrust_per_mass"):
        given, now = (getattr(one.body, key) for one in (model, found.findings.model))
        assert abs(now / given - 1.0) < 0.02
        assert abs(now / getattr(MODEL.body, key) - 1.0) < 0.03
