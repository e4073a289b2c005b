"""The direct loop: the thesis's law on linear models, its metrics, stability and margins."""

import itertools
import math

import msgspec
import numpy as np
import pytest
from scipy.signal import lfilter

from groundstation.control.firmwares import PidGains
from groundstation.control.linear_loop import (
    GAINS,
    ROUNDED_ROLL,
    ROUNDED_YAW,
    DirectJudge,
    axis_plant,
    direct_loop,
    is_stable,
    most_delay,
    printed_cases,
    printed_plant,
    run_direct,
    step_direct,
)
from groundstation.control.metrics import step_metrics
from groundstation.dynamics.model import THESIS, ArxAxis
from groundstation.errors import BadInputError

TS = 0.002


def closed_loop(plant, gains, rows):
    """The same loop as one transfer function, by polynomials alone."""
    kp, ki, kd = gains.as_tuple()
    numerator = np.polyadd(
        np.polyadd(np.polymul([kp], [-1, 1]), [ki * TS, 0]), np.polymul([kd / TS], [1, -2, 1])
    )[::-1]
    b = np.concatenate([np.zeros(plant.nk), plant.b])
    a = np.array([1.0, *plant.a])
    forward = np.convolve(b, numerator)
    alone = np.convolve(a, [1, -1])
    whole = np.zeros(max(len(forward), len(alone)))
    whole[: len(alone)] += alone
    whole[: len(forward)] += forward
    return lfilter(forward, whole, np.ones(rows)), np.roots(whole)


@pytest.mark.parametrize("delay", [1, 2, 8])
@pytest.mark.parametrize("gains", [*(one["roll"] for one in GAINS.values())], ids=[*GAINS])
def test_the_loop_is_the_transfer_function_it_stands_for(gains, delay):
    plant = axis_plant(THESIS, "roll", delay)
    expected, _ = closed_loop(plant, gains, 300)
    np.testing.assert_allclose(step_direct(plant, gains, 0.6), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("axis", ["roll", "yaw"])
def test_jury_agrees_with_the_roots(axis):
    generator = np.random.default_rng(3)
    verdicts = []
    for _ in range(200):
        delay = int(generator.integers(0, 20))
        gains = PidGains(*(10 ** generator.uniform([4, 4, 2], [7, 7, 5])).tolist())
        plant = axis_plant(THESIS, axis, delay)
        _, poles = closed_loop(plant, gains, 10)
        if abs(abs(poles).max() - 1) > 1e-6:
            verdicts.append((is_stable(plant, gains), bool(abs(poles).max() < 1)))
    assert [ours for ours, _ in verdicts] == [theirs for _, theirs in verdicts]
    assert 10 < sum(ours for ours, _ in verdicts) < 190


def test_the_delay_margin_is_the_delay_that_jury_allows():
    for name in ("P", "PI", "PD", "PID"):
        plant = axis_plant(THESIS, "roll", 2)
        margin = direct_loop(plant, GAINS[name]["roll"]).margins.delay_s
        assert math.floor(margin / TS) == most_delay(plant, GAINS[name]["roll"]) - 2, name


def test_gain_margins_end_where_the_loop_does():
    plant = axis_plant(THESIS, "roll", 2)
    gains = GAINS["PID"]["roll"]
    margins = direct_loop(plant, gains).margins
    for factor, stable in (
        (margins.gain_up * 0.98, True),
        (margins.gain_up * 1.02, False),
        (margins.gain_down * 1.02, True),
        (margins.gain_down * 0.98, False),
    ):
        assert is_stable(plant, PidGains(*(factor * g for g in gains.as_tuple()))) is stable
    p = GAINS["P"]["roll"]
    least = direct_loop(plant, p).margins.gain_down
    assert not is_stable(plant, PidGains(p.kp * least * 0.98))
    assert is_stable(plant, PidGains(p.kp * least * 1.02))


def test_the_printed_gains_give_the_known_figures_at_two_and_eight_samples():
    """facts: what the tables reproduce, computed before this code and without it."""
    cases = {(c["controller"], c["axis"], c["delay_samples"]): c for c in printed_cases()}
    two, eight = ({name: cases[name, "roll", delay] for name in GAINS} for delay in (2, 8))
    assert two["P"]["rms"] == pytest.approx(0.62, abs=0.005)
    assert 1 - two["P"]["steady_state_error"] == pytest.approx(1.58, abs=0.01)
    for name, known, rel in (
        ("PI", (0.325, 104), 0.003),
        ("PD", (0.097, 51), 0.01),
        ("PID", (0.135, 72), 0.01),
    ):
        assert (two[name]["rms"], two[name]["overshoot_pct"]) == pytest.approx(known, rel=rel)
        assert not eight[name]["stable"]
    assert eight["P"]["rms"] == pytest.approx(1.23, abs=0.005)
    assert [one["most_delay_samples"] for one in two.values()] == [8, 5, 3, 3]


def test_yaw_as_printed_is_met_at_no_delay_but_by_digits_that_round_to_it():
    for delay in range(1, 9):
        for case in printed_cases((delay,)):
            if case["axis"] == "yaw":
                assert case["rms"] > 2 * case["printed"]["rms"]
    plant = printed_plant(ROUNDED_YAW, 8)
    assert (round(plant.a[0], 3), round(plant.a[1], 4)) == (-1.995, 0.9949)
    for case in printed_cases((2, 8)):
        if case["axis"] == ROUNDED_YAW:
            assert case["stable"]
            assert case["rms"] == pytest.approx(case["printed"]["rms"], rel=0.14)
            assert case["overshoot_pct"] == pytest.approx(case["printed"]["overshoot_pct"], abs=12)


def test_no_digits_that_round_to_the_printed_roll_bear_four_samples():
    plant = axis_plant(THESIS, "roll", 4)
    printed = np.array([*plant.a, *plant.b])
    half = 0.5 * 10.0 ** (np.floor(np.log10(np.abs(printed))) - 3)  # of the fourth digit
    for signs in itertools.product((-1.0, 0.0, 1.0), repeat=len(printed)):
        moved = tuple((printed + half * signs).tolist())
        a, b = moved[: plant.na], moved[plant.na :]
        corner = ArxAxis(plant.na, plant.nb, plant.nk, a, b, plant.ts)
        assert not all(is_stable(corner, GAINS[name]["roll"]) for name in GAINS)


def test_metrics_of_a_known_response():
    time = np.arange(2000) * TS
    y = 1 - np.exp(-8 * time) * np.cos(20 * time)
    found = step_metrics(3 * y, TS, 3.0)
    assert found.rms == pytest.approx(3 * np.sqrt(np.mean((1 - y) ** 2)))
    assert found.overshoot_pct == pytest.approx(100 * (y.max() - 1))
    outside = np.flatnonzero(abs(y - 1) > 0.05)[-1]
    assert found.settling_s == pytest.approx((outside + 1) * TS)
    assert found.steady_state_error == pytest.approx(0, abs=1e-9)
    assert step_metrics(-3 * y, TS, -3.0).overshoot_pct == pytest.approx(found.overshoot_pct)


def test_a_response_that_does_not_stay_has_not_settled():
    time = np.arange(2000) * TS
    assert step_metrics(1 + 0.06 * np.sin(9 * time), TS).settling_s is None
    assert step_metrics(np.exp(time), TS).settling_s is None
    with np.errstate(over="ignore"):
        assert step_metrics(np.exp(400 * time), TS).as_dict()["rms"] is None


def test_a_body_without_polynomials_is_a_double_integrator():
    model = THESIS.__class__(vehicle="crazyflie1", motor=THESIS.motor, body=THESIS.body)
    plant = axis_plant(model, "roll")
    assert not run_direct(plant, PidGains(0.0), np.zeros(5)).any()
    inputs = np.ones(500)
    b = np.concatenate([np.zeros(plant.nk), plant.b])
    angle = lfilter(b, [1, *plant.a], inputs)
    assert angle[-1] == pytest.approx(0.5 * 0.0136 * (499 * TS) ** 2, rel=1e-9)


def test_many_gains_are_judged_as_each_alone():
    plant = axis_plant(THESIS, "roll", 2)
    table = np.array([GAINS[name]["roll"].as_tuple() for name in ("PD", "PID")])
    judged = DirectJudge(plant, 1.0)(table)
    for row, gains in zip(judged, table, strict=True):
        alone = step_metrics(step_direct(plant, PidGains(*gains)), TS)
        assert row[0] == pytest.approx(alone.rms)
        assert row[1] == pytest.approx(alone.overshoot_pct)
        peak = direct_loop(plant, PidGains(*gains)).margins.max_sensitivity
        assert row[4] == pytest.approx(peak, rel=0.01)
    late = DirectJudge(plant, 1.0, spare_s=0.004)(table)
    assert np.isinf(late[:, :6]).all()


def test_what_cannot_be_closed_is_refused():
    with pytest.raises(BadInputError, match="axis 'height'"):
        axis_plant(THESIS, "height")
    with pytest.raises(BadInputError, match="delay of -1"):
        axis_plant(THESIS, "roll", -1)


@pytest.mark.parametrize("channel", ["gyro", "attitude"])
def test_a_loop_around_fitted_polynomials_is_that_around_the_body_they_describe(channel):
    ts, grey = 0.002, msgspec.structs.replace(THESIS, arx=None)
    kick = THESIS.body.c0 * ts
    rate, angle = ArxAxis(1, 1, 0, (-1.0,), (kick,), ts), (-2.0, 1.0)
    turn = ArxAxis(2, 2, 0, angle, (kick * ts / 2, kick * ts / 2), ts)
    fitted = msgspec.structs.replace(
        THESIS,
        arx={"roll": rate if channel == "gyro" else turn},
        fit={"arx": {"channel": channel}},
    )
    gains = PidGains(20000.0, 0.0, 3000.0)
    plants = [axis_plant(model, "roll") for model in (fitted, grey)]
    first, second = (run_direct(plant, gains, np.ones(300)) for plant in plants)
    np.testing.assert_allclose(first, second, atol=1e-6)
    assert most_delay(plants[0], gains) == most_delay(plants[1], gains)


def test_roll_within_its_rounding_gives_the_printed_errors_at_two_samples():
    cases = [case for case in printed_cases((2,)) if case["axis"] == ROUNDED_ROLL]
    assert [case["controller"] for case in cases] == ["P", "PI", "PD", "PID"]
    for case in cases:
        assert case["rms"] == pytest.approx(case["printed"]["rms"], rel=0.16), case["controller"]
