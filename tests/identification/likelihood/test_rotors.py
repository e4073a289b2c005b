"""The rotor speeds behind a flight, as every stage of identification takes them."""

from dataclasses import replace
from functools import lru_cache

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.model import EffectTerm, Estimate, vehicle_model, with_motor
from groundstation.dynamics.simulation import armature_mv, simulate_motor, steady_rev_s
from groundstation.dynamics.vehicle import BUILT_IN, MotorConstants, mean_motor
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import (
    Frame,
    Inputs,
    Rotors,
    lag_of_reports,
    point_of,
    spin_rotors,
)
from groundstation.identification.runs import Run, rotor_squares
from groundstation.prediction.drive import drive_run

ROWS = 2500
SAME = ("supply_v", "gyro", "accelerometer", "attitude", "rotor_rev_s", "debug_s")
FOUR = tuple(MotorConstants(1.2 + 0.1 * i, 9.0 + i, 0.004 * i) for i in range(4))
VEHICLE = BUILT_IN["crazyflie21"]


@pytest.fixture(scope="module")
def run():
    generator = np.random.default_rng(2)
    missing, none = np.full((ROWS, 3), np.nan), np.full((ROWS, 4), np.nan)
    duty = 0.6 + 0.05 * np.sin(np.arange(4) + np.arange(ROWS)[:, None] / 60.0)
    gyro, volts = generator.normal(0.0, 0.01, (ROWS, 3)), np.full(ROWS, 3.9)
    channels = duty, volts, gyro, missing, missing, none, np.zeros(ROWS), none
    return Run("hover", 0.0, 0.002, *channels)


def turned(run, motors, effects):
    """Rotor speeds at the rows of a run and the mean squares before them, both (n, 4), by the
    simulation of motors with known effects."""
    each = len(run.settings) // len(run)
    voltage = armature_mv(run.settings, np.repeat(run.supply_v, each))
    start = steady_rev_s(motors, voltage[0])
    period_s = run.period_s / each
    speed, square = simulate_motor(motors, voltage[each:], period_s, start, effects=effects)
    mean = square.reshape(-1, each, 4).mean(axis=1)
    return speed[::each], np.vstack([start**2, mean])


@pytest.mark.parametrize(
    ("key", "size"),
    [
        (None, 0.0),
        ("motor_dead_voltage.voltage_mv", 120.0),
        ("motor_braking_asymmetry.factor", 0.7),
    ],
)
def test_each_rotor_turns_by_its_own_motor_in_the_fit_as_in_the_search(run, key, size):
    (flight,) = prepare([run])
    mean = mean_motor(FOUR)
    point = point_of(with_motor(vehicle_model(VEHICLE), mean))
    late = slice(ROWS // 2, None)  # the start is settled at a voltage that each takes differently
    if key is None:
        fit = rotor_squares(run, FOUR).square[late]
    else:
        name, parameter = key.split(".")
        point[key] = size
        fit = turned(run, FOUR, {name: {parameter: size}})[1][late]
    search = spin_rotors(flight, point, Frame(VEHICLE, FOUR)).square[late]
    apart = np.ptp(fit.mean(axis=0))
    assert apart > 2000.0
    np.testing.assert_allclose(search, fit, rtol=1e-8)
    alike = spin_rotors(flight, point, Frame(VEHICLE)).square[late].mean(axis=0)
    assert np.ptp(alike) < 0.1 * apart


def test_slow_rows_that_tell_two_settings_turn_rotors_as_fast_rows_do(run):
    """Settings that alternate, as an attitude that is new in every second of them makes them: a
    motor that brakes otherwise than it speeds up answers to more than their mean."""
    alternating = 0.05 * (-1.0) ** np.arange(ROWS)[:, None] * [1, -1, 1, -1]
    fast = replace(run, duty=run.duty + alternating)
    first, second = fast.duty[:-1:2], fast.duty[1::2]
    every_second = {name: getattr(run, name)[1::2] for name in SAME}
    mean, step = 0.5 * (first + second), second - first
    told = replace(run, period_s=0.004, duty=mean, duty_step=step, **every_second)
    untold = replace(told, duty_step=np.full_like(step, np.nan))
    model = with_motor(vehicle_model(VEHICLE), mean_motor(FOUR))
    braked = EffectTerm("motor_braking_asymmetry", {"factor": Estimate(0.6)})
    model = msgspec.structs.replace(model, effects=(braked,))
    late = slice(ROWS // 4, None)

    def simulated(one):
        return turned(one, model.motor, {"motor_braking_asymmetry": {"factor": 0.6}})[0] ** 2

    def searched(one):
        (flight,) = prepare([one])
        return spin_rotors(flight, point_of(model), Frame(VEHICLE)).end ** 2

    def predicted(one):
        return drive_run(model, one).rotor_rev_s ** 2

    for behind in (simulated, searched, predicted):
        true = behind(fast)[1::2][late]
        np.testing.assert_allclose(behind(told)[late], true, rtol=1e-6)
        assert np.abs(behind(untold)[late] / true - 1.0).min() > 0.01


PERIOD_S, HZ = 2e-3, 9.0


def speeds(late_s, rows=400):
    """Of four rotors at rows that come ``late_s`` later: speed, mean square over the period before,
    mean speed and its slope, by the calculus of a sine."""
    t = PERIOD_S * np.arange(rows)[:, None] - late_s
    w, turn = 2.0 * np.pi * HZ, np.array([0.0, 0.7, 1.9, 3.1])
    end = 210.0 + 30.0 * np.sin(w * t + turn)

    def integral(t):
        angle = w * t + turn
        square = 0.5 * 900.0 * (t - np.sin(2.0 * angle) / (2.0 * w))
        return 210.0**2 * t - 2.0 * 210.0 * 30.0 * np.cos(angle) / w + square

    square = (integral(t) - integral(t - PERIOD_S)) / PERIOD_S
    before = 210.0 + 30.0 * np.sin(w * (t - PERIOD_S) + turn)
    return end, square, 0.5 * (end + before), (end - before) / PERIOD_S


@pytest.mark.parametrize("delay_s", [0.0, 0.4e-3, 2e-3, 5.7e-3, -1.3e-3])
def test_speeds_are_those_of_so_long_before(delay_s):
    end, square, _, _ = speeds(0.0)
    late = Inputs.of(Rotors(end, square), delay_s, PERIOD_S)
    whole = slice(6, -3)
    for found, true, error in zip(
        (late.last, np.square(late.mean), late.rotor, late.slope),
        speeds(delay_s),
        (2e-3, 1.0, 2e-3, 1.5),
        strict=True,
    ):
        assert np.allclose(np.transpose(found)[whole], true[whole], rtol=0.0, atol=error)


@pytest.mark.parametrize("delay_s", [0.0, 5.7e-3, -1.3e-3])
def test_speeds_that_do_not_change_are_the_same_from_the_first_row_to_the_last(delay_s):
    still = np.full((30, 4), 180.0)
    late = Inputs.of(Rotors(still, still**2), delay_s, PERIOD_S)
    for rows in (late.mean, late.last, late.rotor):
        assert np.allclose(rows, 180.0, rtol=1e-12)
    assert np.allclose(late.slope, 0.0, atol=1e-9)


def test_a_report_that_lags_drives_the_rotors_of_a_late_flight_as_well():
    """Of which only its own rows are reckoned, and some beside them."""
    rows, period_s, lag_s = 9000, 0.01, 0.1
    on = np.repeat([0.0, 1.0, 0.0, 1.0], (2000, 500, 4500, 2000))
    duty = on[:, None] * (0.6 + 0.1 * np.sin(np.arange(4) + np.arange(rows)[:, None] / 20.0))
    volts = 4.1 - 0.3 * (duty**2).mean(axis=1)
    keep, reported = np.exp(-period_s / lag_s), volts.copy()
    for i in range(1, rows):
        reported[i] = keep * reported[i - 1] + (1.0 - keep) * volts[i]
    missing, none = np.full((rows, 3), np.nan), np.full((rows, 4), np.nan)
    gyro = np.random.default_rng(3).normal(0.0, 0.01, (rows, 3))
    channels = duty, reported, gyro, missing, missing, none, np.zeros(rows), none
    run = Run("hops", 0.0, period_s, *channels)
    *_, flight = prepare([run])
    assert flight.run.start_s + flight.first * period_s > 0.5 * rows * period_s
    beside = slice(rows - len(flight.run), rows)
    point = point_of(vehicle_model(VEHICLE)) | {"battery_reading_lag.time_constant_s": lag_s}
    behind = spin_rotors(flight, point, Frame(VEHICLE)).end[flight.rows]
    told = replace(flight, run=replace(run, supply_v=volts)[beside])
    true = spin_rotors(told, point_of(vehicle_model(VEHICLE)), Frame(VEHICLE)).end[flight.rows]
    np.testing.assert_allclose(behind, true, rtol=0.01)


@lru_cache
def flown(lag_s, seconds=24.0, period_s=0.002):
    """A flight in which collective thrust steps, and the voltage at its motors, mV: a cell that
    loses charge along a bent curve behind a resistance, its report filtered 100 times a second and
    in steps of 2 mV. By Euler, and no function of the package."""
    rows, random, motor = round(seconds / period_s), np.random.default_rng(7), VEHICLE.motor
    steps = np.repeat(random.normal(0.0, 0.06, round(seconds / 0.4)), round(0.4 / period_s))
    duty = 0.55 + steps[:rows, None] + random.normal(0.0, 0.01, (rows, 4))
    back, speed, charge = motor.a1 / motor.a0, np.full(4, 200.0), 1.0
    true, reported, kept = np.empty(rows), np.empty(rows), None
    for i, setting in enumerate(duty):
        cell = 4180.0 - 250.0 * (1.0 - charge) - 900.0 * (1.0 - charge) ** 3
        squares, induced = float(setting @ setting), back * float(setting @ speed)
        true[i] = (cell + 0.043 * induced) / (1.0 + 0.09 * squares)
        charge -= period_s * (squares * true[i] - 0.25 * induced) / 2300.0 / 900.0
        pull = motor.a0 * setting * true[i] - (motor.a1 + motor.a2 * speed) * speed
        speed = speed + period_s * pull
        if i % round(0.01 / period_s) == 0:
            read = true[i] + random.normal(0.0, 1.0)
            share = 1.0 if kept is None or lag_s == 0.0 else 1.0 - np.exp(-0.01 / lag_s)
            kept = read if kept is None else kept + share * (read - kept)
        reported[i] = 2.0 * np.round(0.5 * kept)
    missing, none = np.full((rows, 3), np.nan), np.full((rows, 4), np.nan)
    gyro = random.normal(0.0, 0.01, (rows, 3))
    channels = duty, 1e-3 * reported, gyro, missing, missing, none, np.zeros(rows), none
    (flight,) = prepare([Run("steps", 0.0, period_s, *channels)])
    return flight, 1e-3 * true


def test_a_report_says_itself_by_how_much_it_lags():
    flight, _ = flown(0.155)
    shown = lag_of_reports([flight], point_of(vehicle_model(VEHICLE)), Frame(VEHICLE))
    (lag_s,) = shown.centre.values()
    assert lag_s == pytest.approx(0.155, rel=0.08)


def test_a_report_that_does_not_lag_shows_none():
    flight, _ = flown(0.0)
    point, frame = point_of(vehicle_model(VEHICLE)), Frame(VEHICLE)
    assert lag_of_reports([flight], point, frame) is None
    still = replace(flight, run=replace(flight.run, supply_v=np.full(len(flight.run), 3.9)))
    assert lag_of_reports([still], point, frame) is None


def test_what_a_report_says_of_its_lag_is_no_reason_to_believe_in_one():
    flight, _ = flown(0.155)
    point, frame = point_of(vehicle_model(VEHICLE)), Frame(VEHICLE)
    shown = lag_of_reports([flight], point, frame)
    (key,) = shown.keys
    assert shown.at(point)[2] == 0.0
    assert shown.at(point | {key: 0.1})[2] > 10.0


def test_rotors_behind_a_report_that_lags_turn_as_by_the_voltage_itself():
    """To half a millivolt in seconds: sag of a few hundredths of an ohm is no more."""
    flight, volts = flown(0.155)
    point, frame = point_of(vehicle_model(VEHICLE)), Frame(VEHICLE)
    late = point | {"battery_reading_lag.time_constant_s": 0.15}  # by 15 readings, on the mean
    told = replace(flight, run=replace(flight.run, supply_v=volts))
    found, true, plain = (
        spin_rotors(one, at, frame).end[flight.rows].mean(axis=1)
        for one, at in ((flight, late), (told, point), (flight, point))
    )

    def slow(error):
        return np.convolve(error / true, np.full(100, 0.01), "valid").std()

    assert slow(found - true) < 1.4e-4
    assert slow(found - true) < 0.05 * slow(plain - true)
