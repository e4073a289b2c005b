"""The firmware's loops on a model: like the stand-in's firmware, with margins that hold."""

import functools
import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from firmware_sim.craft import StandInSettings
from groundstation.control.firmware_loop import (
    CascadeJudge,
    cascade_loop,
    load_gains,
    plant_of_model,
    require_gains,
    run_cascade,
    step_response,
)
from groundstation.control.firmwares import PLATFORMS, RELEASE_2014
from groundstation.control.metrics import step_metrics
from groundstation.control.programme import Programme
from groundstation.control.report import flight_lines
from groundstation.control.step_analysis import analyse
from groundstation.dynamics.model import THESIS, EffectTerm, Estimate, load_model, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.errors import BadInputError
from support import ROOT
from support.flights import fly_offline

DATA = Path(__file__).parent / "data"
STAND_IN = (ROOT / "docs" / "stand_in.md").read_text()
TS = 0.002
REDUCED = {
    f"{loop}.{axis}_{gain}": value
    for axis in ("roll", "pitch")
    for loop, gain, value in (
        ("pid_rate", "kp", 30.0),
        ("pid_attitude", "kp", 3.0),
        ("pid_attitude", "ki", 3.0),
    )
}


def late_model(delay_s=0.0033, vehicle="crazyflie1"):
    term = EffectTerm("dead_time", {"delay_s": Estimate(delay_s)})
    base = vehicle_model(BUILT_IN[vehicle])
    return base.__class__(vehicle=base.vehicle, motor=base.motor, body=base.body, effects=(term,))


def late(plant, delay_s):
    """The same, measured later."""
    sensor = plant.sensor.copy()
    sensor["delay"] = delay_s
    return replace(plant, sensor=sensor)


@pytest.mark.parametrize(
    ("vehicle", "gains"),
    [("crazyflie1", {}), ("crazyflie1", REDUCED), ("crazyflie21", {})],
    ids=["stock", "reduced", "today"],
)
def test_the_loop_becomes_unstable_at_its_delay_margin(vehicle, gains):
    """Roll's, which is the shortest: a delay is that of all axes."""
    plant = plant_of_model(late_model(vehicle=vehicle))
    margin = cascade_loop(plant, gains, "roll").margins.delay_s

    def grows(delay_s):
        y = step_response(late(plant, delay_s), gains, "roll", 8.0)
        swings = [np.ptp(part) for part in np.split(y[1000:], 3)]
        return swings[2] > swings[1]

    assert not grows(0.0033 + 0.85 * margin)
    assert grows(0.0033 + 1.15 * margin)


@pytest.mark.parametrize("vehicle", ["crazyflie1", *PLATFORMS])
@pytest.mark.parametrize("axis", ["roll", "yaw"])
def test_crossover_and_phase_are_those_of_the_page_which_were_worked_out_apart(vehicle, axis):
    ours = cascade_loop(plant_of_model(late_model(vehicle=vehicle)), {}, axis).margins
    (line,) = re.findall(rf"^\| {vehicle} \| {axis} \|(.*)\|$", STAND_IN, re.MULTILINE)
    crossover_rad_s, phase_deg = map(float, line.split("|"))
    assert ours.crossover_rad_s == pytest.approx(crossover_rad_s, rel=0.05)
    assert ours.phase_deg == pytest.approx(phase_deg, abs=3.0)


def test_a_flight_of_the_stand_in_goes_as_predicted():
    """Faithful craft, 8 doublets an axis: RMS, overshoot and settling as the acceptance asks."""
    gains = load_gains(DATA / "gains.toml")
    settings = StandInSettings(program="wait", altitude_hold=True, gains=gains, seed=1)
    samples, sent, setpoints, _ = fly_offline(settings, Programme(repeats=8), jitter_s=0.003)
    plant = plant_of_model(load_model(DATA / "body.json"))
    flown = analyse(samples, sent, setpoints, "plus", plant, gains)
    assert [one.axis for one in flown.axes] == ["roll", "pitch", "yaw"]
    assert {one.axis: one.apart for one in flown.axes} == {"roll": [], "pitch": [], "yaw": []}
    assert flown.found == flown.edges == 72
    assert 0.002 < flown.delay_s < 0.010
    # a busy host hears of the craft's time up to 0.3 s late, more and less
    wander = 0.15 * (1 + np.sin(1e-9 * sent))
    late = analyse(samples, sent + (1e9 * wander).astype(np.int64), setpoints, "plus", plant, gains)
    assert late.found == 72
    assert late.spread_s > 0.1
    assert {one.axis: one.apart for one in late.axes} == {"roll": [], "pitch": [], "yaw": []}


@pytest.mark.parametrize("craft", ["crazyflie21", "brushless"])
def test_stock_gains_fly_todays_craft_as_predicted(craft):
    """Attitude setpoints at today's loops, mixer and battery compensation, written apart."""
    settings = StandInSettings(
        craft=craft, plant="reduced", program="wait", altitude_hold=True, seed=1
    )
    samples, sent, setpoints, _ = fly_offline(settings, Programme(repeats=2), jitter_s=0.003)
    plant = plant_of_model(vehicle_model(BUILT_IN[craft]), fusion=False)
    flown = analyse(samples, sent, setpoints, "x", plant, {}, holds_heading=True)
    assert {one.axis: one.apart for one in flown.axes} == {"roll": [], "pitch": [], "yaw": []}
    for one in flown.axes:
        # 3 ms of the steepest rise: how late a setpoint was
        np.testing.assert_allclose(one.response, one.predicted_response, atol=0.05)
    assert flown.found == flown.edges == 12
    brisk = {"pid_attitude.roll_kp": 9.0, "pid_attitude.yaw_kp": 9.0}
    other = analyse(samples, sent, setpoints, "x", plant, brisk, holds_heading=True)
    assert [bool(one.apart) for one in other.axes] == [True, False, True]


@functools.cache
def flown_twice():
    """Samples, and when which setpoints were sent, of two doublets an axis."""
    settings = StandInSettings(program="wait", altitude_hold=True, seed=1)
    return fly_offline(settings, Programme(repeats=2), jitter_s=0.003)[:3]


def test_a_flight_in_which_fewer_rows_were_asked_for_is_judged_and_a_restart_is_not():
    samples, sent, setpoints = flown_twice()
    whole = analyse(samples, sent, setpoints)
    half = len(samples) // 2
    rows = np.r_[:half, half + 20 : len(samples) : 2]
    fewer = samples[rows]
    fewer.segment[half:] += 1
    flown = analyse(fewer, sent, setpoints)
    assert flown.edges == 18
    assert flown.found >= whole.found > 12
    for one, other in zip(flown.axes, whole.axes, strict=True):
        apart = [a - b for a, b in zip(one.response, other.response, strict=False)]
        assert len(apart) > 300
        assert np.std(apart) < 0.02
    missing = fewer[np.r_[:half, half + 40 : len(fewer)]]
    with pytest.raises(BadInputError, match=r"telemetry fails for 0\.2 s in the flight"):
        analyse(missing, sent, setpoints)
    fewer.ticks[half:] -= fewer.ticks[half]
    with pytest.raises(BadInputError, match="the craft restarted in the flight"):
        analyse(fewer, sent, setpoints)


def test_motors_that_stand_still_are_not_said_to_have_answered():
    samples, sent, setpoints = flown_twice()
    still = replace(samples, duty=np.zeros_like(samples.duty))
    flown = analyse(still, sent, setpoints)
    assert (flown.found, flown.edges) == (0, 18)
    assert "no setpoint is seen in the motors (0 of 18 edges)" in flight_lines(flown)[-1]


def test_the_battery_does_not_change_todays_loops_and_changes_those_of_2014():
    model = late_model(vehicle="crazyflie21")
    apart = {}
    for release in ("2014", "2.x"):
        plant = plant_of_model(model, release=release)
        full, empty = (step_response(plant, {}, "roll", 1.0, mv) for mv in (4100.0, 3300.0))
        apart[release] = abs(full - empty).max()
    assert apart["2.x"] < 0.002 < 0.02 < apart["2014"]


def test_a_plus_is_not_flown_by_todays_firmware():
    with pytest.raises(BadInputError, match="crazyflie1 is a plus"):
        plant_of_model(late_model(), release="2.x")


def test_a_wrong_model_is_told_by_its_flight():
    gains = load_gains(DATA / "gains.toml")
    settings = StandInSettings(program="wait", altitude_hold=True, gains=gains, seed=3)
    programme = Programme(axes=("roll", "yaw"), repeats=4)
    samples, sent, setpoints, _ = fly_offline(settings, programme)
    plant = plant_of_model(load_model(DATA / "body.json"))
    plant.craft["inertia"] /= 0.6
    flown = analyse(samples, sent, setpoints, "plus", plant, gains)
    assert all(one.apart for one in flown.axes)


def test_a_derivative_of_2014_s_rate_loop_has_no_effect():
    plant = plant_of_model(late_model())
    derivative = {**REDUCED, "pid_rate.roll_kd": 1.0}
    np.testing.assert_array_equal(
        step_response(plant, derivative, "roll", 0.5), step_response(plant, REDUCED, "roll", 0.5)
    )


def test_an_integral_is_clamped_at_its_limit():
    plant = plant_of_model(late_model())
    plant.craft["inertia"] *= 1e9  # nothing turns: the error stays
    setpoints = np.zeros((3000, 3))
    setpoints[:, 0] = 0.4
    gains = {
        **dict.fromkeys(RELEASE_2014.stock, 0.0),
        "pid_rate.roll_kp": 1.0,
        "pid_attitude.roll_ki": 10.0,
    }
    pwm = run_cascade(plant, gains, setpoints, 30000.0).pwm
    output = 128 * (pwm[:, 3] - pwm[:, 1]) / 2
    assert output[-1] == pytest.approx(10.0 * 20.0)
    assert output[500] < 0.9 * output[-1]


def test_many_gains_are_judged_as_each_alone():
    table_of = {
        ("crazyflie1", "roll"): [[15.0, 3.0, 1.0, 0.0], [4.0, 3.0, 2.0, 0.3]],
        ("crazyflie1", "yaw"): [[50.0, 25.0]],
        ("crazyflie21", "roll"): [[250.0, 500.0, 2.5, 6.0, 3.0], [120.0, 50.0, 4.0, 8.0, 1.0]],
        ("brushless", "yaw"): [[120.0, 16.7, 6.0, 1.0], [200.0, 20.0, 4.0, 0.5]],
    }
    for (vehicle, axis), table in table_of.items():
        plant = plant_of_model(late_model(vehicle=vehicle))
        judged = CascadeJudge([plant], axis, 1.5)(np.array(table))
        for row, values in zip(judged, table, strict=True):
            gains = dict(zip(plant.firmware.gain_names(axis), values, strict=True))
            alone = step_metrics(step_response(plant, gains, axis), TS)
            assert row[0] == pytest.approx(alone.rms, rel=1e-6)
            assert row[2] == pytest.approx(alone.settling_s)
            peak = cascade_loop(plant, gains, axis).margins.max_sensitivity
            assert row[4] == pytest.approx(peak, rel=0.02)


def test_trim_has_no_part_in_how_gains_are_judged():
    uneven = EffectTerm("rotor_mismatch", {"rotor": Estimate(1.0), "excess": Estimate(0.03)})
    model = late_model(vehicle="crazyflie21")
    table = np.array([[250.0, 500.0, 2.5, 6.0, 3.0], [120.0, 50.0, 4.0, 8.0, 1.0]])
    even, trimmed = (
        CascadeJudge(
            [plant_of_model(msgspec.structs.replace(model, effects=effects))], "pitch", 1.5
        )
        for effects in (model.effects, (*model.effects, uneven))
    )
    # rms, overshoot, settling, offset
    for one, other, within in zip(
        even(table).T, trimmed(table).T, (0.003, 1.0, 0.02, 0.01), strict=False
    ):
        assert one == pytest.approx(other, abs=within)


def test_a_judge_calls_unstable_what_runs_away():
    plant = plant_of_model(late_model())
    table = np.array([[70.0, 3.5, 2.0, 0.0], [200.0, 3.5, 2.0, 0.0], [15.0, 3.0, 1.0, 0.0]])
    judged = CascadeJudge([plant], "roll", 1.5)(table)
    assert np.isfinite(judged[:, 0]).tolist() == [False, False, True]
    late = CascadeJudge([plant], "roll", 1.5, spare_s=0.05)(table[2:])
    assert not np.isfinite(late[0, 0])


def test_effects_of_the_velocity_act_too():
    rears_up = EffectTerm("velocity_moment", {"moment": Estimate(30.0)})
    model = late_model()
    moved = msgspec.structs.replace(model, effects=(*model.effects, rears_up))
    one, other = (step_response(plant_of_model(m), REDUCED, "roll", 1.0) for m in (model, moved))
    assert abs(one - other).max() > 0.02


def test_parameters_that_are_not_given_and_a_filter_of_no_width_are_no_fault():
    plain = THESIS.__class__(vehicle="crazyflie1", motor=THESIS.motor, body=THESIS.body)
    none = EffectTerm("gyro_low_pass", {"bandwidth_hz": Estimate(0.0)})
    default = EffectTerm("dead_time", {})
    model = msgspec.structs.replace(plain, effects=(none, default))
    assert plant_of_model(model).sensor[0]["delay"] == pytest.approx(0.004)
    assert plant_of_model(model).gyro_response(np.array([10j])) == 1.0


@pytest.mark.parametrize(
    ("gains", "complaint"),
    [
        ({"pid_rate.roll_kq": 1.0}, "no gain of the firmware"),
        ({"pid_rate.roll_kp": float("nan")}, "is nan"),
        ({"pid_rate.roll_kp": float("inf")}, "is inf"),
        ({"pid_rate.roll_kp": -1.0}, "must be 0..1000"),
        ({"pid_rate.roll_kp": 1e6}, "must be 0..1000"),
    ],
)
def test_gains_that_cannot_be_are_refused_by_name(gains, complaint):
    with pytest.raises(BadInputError, match=complaint):
        require_gains(gains, "gains")


def test_thrust_and_supply_of_any_form_are_flown_by_one_compiled_kernel():
    """Another for arrays that are read-only took every first ``pid`` command half a minute more."""
    from groundstation.control.kernels import cascade_run

    plant, setpoints = plant_of_model(THESIS), np.zeros((50, 3))
    supply = np.full(50, 3700.0)
    supply.flags.writeable = False
    by_number = run_cascade(plant, REDUCED, setpoints, 30000.0, 3700.0)
    known = list(cascade_run.signatures)
    by_row = run_cascade(plant, REDUCED, setpoints, np.broadcast_to(30000.0, 50), supply)
    run_cascade(plant, REDUCED, setpoints)
    assert cascade_run.signatures == known
    np.testing.assert_array_equal(by_row.pwm, by_number.pwm)
