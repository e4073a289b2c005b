"""What the firmware's loops do at their limits, where ``test_firmware_replay.py`` does not fly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from firmware_sim import stabilizer
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.physics import firmware, parameters
from firmware_sim.settings import Quirks, Sensor
from support.plant import callable_piece, craft_after, programme, rows_of

angle_loops = callable_piece(stabilizer.angle_loops)
rate_loop = callable_piece(stabilizer.rate_loop)
stabilize = callable_piece(stabilizer.stabilize)

NO_QUIRKS = Quirks(attitude_dt=False, clamp_macro=False, lower_limit=False, negate=False)


def loops(quirks: Quirks = NO_QUIRKS, **gains: float) -> Any:
    settings = StandInSettings(quirks=quirks, gains=gains)
    fw, p = firmware(settings), parameters(settings)
    fw["thrust"] = 40000.0
    return p, fw


def test_the_clamp_macro_takes_the_derivative_away():
    outputs = []
    for quirks in (NO_QUIRKS, Quirks()):
        _, fw = loops(quirks, **{"pid_rate.roll_kd": 0.5})
        fw["rate_desired"] = 10.0, 0.0, 0.0
        outputs.append(rate_loop(fw[0], 0, 0.0))
    assert outputs == [700.0 + 0.5 * 10 / 0.002, 700.0]


def test_a_saturated_output_is_evaluated_less_often():
    _, fw = loops(Quirks())
    fw["rate_desired"] = 0.0, 0.0, 4000.0
    assert rate_loop(fw[0], 2, 0.0) == 32767.0
    assert fw["rate_integral"][0, 2] == pytest.approx(2 * 4000 * 0.002)
    _, fw = loops(Quirks())
    fw["rate_desired"] = 0.0, 0.0, -4000.0
    assert rate_loop(fw[0], 2, 0.0) == -32768.0
    assert fw["rate_integral"][0, 2] == pytest.approx(-4000 * 0.002)


def test_only_the_upper_limit_of_an_integral_holds():
    bounds = []
    for quirks in (NO_QUIRKS, Quirks(clamp_macro=False)):
        for rate in (400.0, -400.0):
            _, fw = loops(quirks)
            fw["rate_desired"] = 0.0, 0.0, rate
            for _ in range(5000):
                rate_loop(fw[0], 2, 0.0)
            bounds.append(fw["rate_integral"][0, 2])
    assert bounds == pytest.approx([500, -500, 500, -4000])


def test_the_angle_integrals_stop_at_20_degree_seconds():
    _, fw = loops(Quirks())
    fw["setpoint"] = 25.0, 25.0, 0.0
    for _ in range(1000):
        angle_loops(fw[0])
    assert fw["angle_integral"][0].tolist() == [20.0, 20.0, 0.0]


def test_the_most_negative_yaw_output_keeps_its_sign():
    differences = []
    for quirks in (NO_QUIRKS, Quirks(clamp_macro=False)):
        p, fw = loops(quirks)
        fw["rate_desired"] = 0.0, 0.0, -4000.0
        stabilize(p[0], fw[0])
        differences.append(int(fw["compare"][0, 0] - fw["compare"][0, 1]))
    assert differences[0] > 0 > differences[1]


def test_motor_outputs_clamp_one_by_one():
    p, fw = loops()
    fw["thrust"] = 60000.0
    fw["rate_desired"] = 0.0, 400.0, 0.0
    stabilize(p[0], fw[0])
    assert fw["compare"][0].tolist() == [511, 60000 >> 7, (60000 - 28000) >> 7, 60000 >> 7]


def test_zero_thrust_stops_the_motors_and_forgets_the_integrals():
    p, fw = loops(Quirks())
    fw["rate_desired"] = 50.0, 50.0, 50.0
    for _ in range(10):
        stabilize(p[0], fw[0])
    assert np.abs(fw["rate_integral"]).min() > 0
    fw["thrust"] = 0.0
    stabilize(p[0], fw[0])
    assert fw["compare"][0].tolist() == [0, 0, 0, 0]
    assert not fw["rate_integral"].any()


def waiting() -> StandIn:
    craft = craft_after(4.0, program="wait", plant="reduced")
    return craft


def test_a_lost_client_means_level_after_half_a_second_and_silence_after_two():
    craft = waiting()
    craft.command(10.0, -5.0, 20.0, 45000)
    history = []
    for step in range(300):
        craft.advance(4.0 + 0.01 * (step + 1))
        history.append((craft.state().thrust, tuple(craft._firmware[0]["setpoint"])))
    assert history[45] == (45000, (10.0, -5.0, 20.0))
    assert history[55] == (45000, (0.0, 0.0, 0.0))
    assert history[195][0] == 45000
    assert history[205][0] == 0


@pytest.mark.parametrize(
    ("asked", "given"), [(10000, 0), (10001, 10001), (60000, 60000), (65535, 60000)]
)
def test_thrust_has_a_floor_and_a_ceiling(asked, given):
    craft = waiting()
    craft.command(0.0, 0.0, 0.0, asked)
    craft.advance(4.01)
    assert craft.state().thrust == given


def test_a_client_that_stays_silent_gives_the_craft_back_to_the_pilot():
    craft = craft_after(8.0, program="hover", plant="reduced", resume_s=3.0)
    craft.command(0.0, 0.0, 0.0, 0)
    craft.advance(10.0)
    assert craft.state().position_m[2] < 0.1
    craft.advance(16.0)
    assert craft.state().position_m[2] == pytest.approx(0.8, abs=0.1)


def test_with_altitude_hold_the_pilot_keeps_the_height_while_a_client_steers():
    craft = StandIn(StandInSettings(program="wait", altitude_hold=True))
    time_s = 4.0
    craft.advance(time_s)
    heights = []
    for step in range(1000):
        craft.command(4.0 if step % 200 > 150 else 0.0, 0.0, 0.0, 40000)
        time_s += 0.01
        craft.advance(time_s)
        heights.append(craft.state().position_m[2])
    assert np.array(heights[500:]) == pytest.approx(0.8, abs=0.1)
    craft.command(0.0, 0.0, 0.0, 0)
    craft.advance(time_s + 3.0)
    assert craft.state().position_m[2] < 0.01


def test_the_gyro_bias_is_found_once_at_start_up_and_kept_out_of_the_loops():
    sensor = Sensor(gyro_bias_dps=(3.0, -2.0, 1.0))
    craft = StandIn(StandInSettings(program="wait", sensor=sensor))
    packets, _ = craft.advance(1.5)
    assert not craft.state().calibrated
    craft.advance(2.5)
    assert craft.state().calibrated
    assert craft._firmware[0]["bias"] == pytest.approx([49, -33, 16], abs=1)
    assert np.abs(craft.state().gyro_dps).max() < 0.5
    raw = rows_of(packets)["gyro"][300:].mean(axis=0)  # telemetry carries the raw register
    assert raw == pytest.approx([49.2, -32.8, 16.4], abs=2.0)


def test_a_craft_that_is_moved_finds_no_bias(tmp_path):
    sine = {"axis": "roll", "shape": "sine", "amplitude": 5, "end_s": 6}
    shaky = programme(tmp_path, {"kind": "hand", "seconds": 20, "excite": [sine]})
    craft = craft_after(5.5, program=shaky)
    assert not craft.state().calibrated
    craft.advance(8.0)
    assert craft.state().calibrated
