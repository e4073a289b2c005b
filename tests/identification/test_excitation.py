"""What is said of a recording before anything is fitted, against what the fit then finds."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.dynamics.motor import simulate_motor
from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR
from groundstation.errors import BadInputError
from groundstation.identification.body.fit import fit_body, motor_pace
from groundstation.identification.excitation import (
    body_excitation,
    flight_excitation,
    motor_excitation,
)
from groundstation.identification.motor.fit import fit_motor
from groundstation.identification.motor.problem import MotorRun
from groundstation.identification.runs import runs_of
from groundstation.identification.stretches import stretches_of
from support.flights import recorded

VEHICLE = BUILT_IN["crazyflie1"]


def flown(seconds, **settings):
    samples, _ = recorded(seconds, **{"plant": "reduced", **settings})
    return stretches_of(runs_of(samples, "flight"), THESIS_MOTOR)


@pytest.fixture(scope="module")
def excited():
    return flown(26.0, seed=61)


@pytest.fixture(scope="module")
def faithful():
    return flown(26.0, seed=61, plant="faithful")


@pytest.mark.parametrize(
    ("plant", "effects"),
    [
        ("excited", ()),
        ("excited", ("rate_damping", "centre_of_gravity_offset")),
        ("faithful", ("dead_time", "rotor_acceleration_torque", "inertia_coupling")),
    ],
)
def test_predicted_uncertainty_is_what_the_fit_then_reports(plant, effects, request):
    stretches = request.getfixturevalue(plant)
    expected = body_excitation(stretches, VEHICLE, effects)
    fit = fit_body(stretches, VEHICLE, effects)
    assert expected.names == fit.estimates.names[:-1]
    ratio = expected.stderr / fit.estimates.stderr[:-1]
    assert np.all((ratio > 0.4) & (ratio < 2.5)), dict(zip(expected.names, ratio, strict=True))
    assert not any("hardly excited" in line for line in expected.lines)


def test_what_a_flight_can_tell_is_what_its_fits_then_report(faithful):
    expected = flight_excitation(faithful, VEHICLE)
    estimates = fit_body(faithful, VEHICLE, ("dead_time", "rotor_acceleration_torque")).estimates
    stderr = dict(zip(estimates.names, estimates.stderr, strict=True))
    fitted = {name: stderr[name] / estimates[name] for name in list(expected)[:4]}
    fitted["motor_pace"] = motor_pace(faithful, VEHICLE)[1]
    assert list(expected) == ["c0", "c1", "c2", "thrust_per_mass", "motor_pace"]
    for name, share in expected.items():
        assert share == pytest.approx(fitted[name], rel=0.35), name


def test_a_still_hover_is_said_to_be_poor_and_what_to_fly_before_the_fit():
    quiet = flown(13.0, seed=62, program="hover", sensor_noise=0.2)
    found = body_excitation(quiet, VEHICLE)
    (line,) = (text for text in found.lines if text.startswith("yaw is hardly excited"))
    assert "c2 will be uncertain by" in line
    assert "fly yaw steps" in line
    share = found.share[found.names.index("c2")]
    assert f"by {100 * share:.0f} %" in line


def test_what_is_beyond_hope_is_refused_before_the_fit(excited):
    (stretch,) = excited
    still = replace(stretch.run, gyro=stretch.run.gyro.copy())
    generator = np.random.default_rng(0)
    still.gyro[:, 2] += np.cumsum(generator.normal(0, 3.0, len(still)))
    with pytest.raises(BadInputError, match=r"flight: yaw is hardly excited.*fly yaw steps"):
        body_excitation([replace(stretch, run=still)], VEHICLE)


def test_an_effect_that_cannot_show_is_named_with_what_to_fly():
    hover = flown(13.0, seed=63, program="hover")
    found = body_excitation(hover, VEHICLE, ("quadratic_rate_damping",))
    assert any(
        "quadratic_rate_damping hardly shows" in text and "3 rad/s" in text for text in found.lines
    )


def motor_run(spread_mv, seconds=8.0, noise=0.3, level=2200.0):
    generator = np.random.default_rng(7)
    rows = round(seconds / 0.002)
    voltage = level + np.repeat(generator.uniform(-spread_mv, spread_mv, rows // 100), 100)
    speed, _ = simulate_motor(THESIS_MOTOR, voltage[1:, None], 0.002)
    measured = speed[:, 0] + generator.normal(0, noise, rows)
    return MotorRun("motor", 0.002, voltage, measured, np.zeros(rows), np.zeros(rows))


def test_predicted_uncertainty_of_a_motor_is_what_its_fit_reports():
    run = motor_run(1300.0)
    expected, fit = motor_excitation([run]), fit_motor([run])
    ratio = expected.stderr / fit.estimates.stderr[:3]
    assert np.all((ratio > 0.4) & (ratio < 2.5))
    assert not expected.lines


def test_a_motor_around_one_speed_is_said_to_be_poor_before_the_fit():
    found = motor_excitation([motor_run(50.0, noise=3.0)])
    assert any("a2 is hardly excited" in text and "30 to 90 % duty" in text for text in found.lines)
    with pytest.raises(BadInputError, match="motor: a0 is hardly excited"):
        motor_excitation([motor_run(50.0, seconds=1.2, noise=60.0)])
