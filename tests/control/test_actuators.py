"""Gains that no motor follows."""

from pathlib import Path

import numpy as np
import pytest

from groundstation.control.firmwares import PidGains
from groundstation.control.linear_loop import (
    counts_per_control,
    most_control,
    motors_and_body,
    reason_not_followed,
)
from groundstation.dynamics.model import load_model
from groundstation.dynamics.simulation import steady_rev_s

MODEL = load_model(Path(__file__).parent / "data" / "body.json")


def test_gains_that_leave_the_motors_room_are_followed():
    counts = counts_per_control(MODEL)[0]
    calm = PidGains(38.5 / counts, 0.04 / counts, 21.3 / counts)
    assert reason_not_followed(MODEL, calm, "roll") == ""


@pytest.mark.parametrize(
    ("axis", "gains", "said"),
    [
        ("yaw", PidGains(7.5e6, 0.0, 1e5), "instead of 0"),  # of polynomials of held angles
        ("roll", PidGains(1.53e6, 0.0, 10200.0), "behind which the loop is unstable"),  # Table 8.3
        ("yaw", PidGains(217.0, 21.0, 1.46e5), "the angle misses the step by 0"),
    ],
)
def test_gains_that_no_motor_follows_are_told_with_what_they_ask_and_what_there_is(
    axis, gains, said
):
    reason = reason_not_followed(MODEL, gains, axis)
    assert reason.startswith(f"{axis}: kp {gains.kp:.3g}, kd {gains.kd:.3g} ask u' = ")
    assert "lag of 102 ms" in reason
    assert said in reason


def test_the_most_control_is_what_full_motors_on_one_side_give():
    full, hover = (
        float(steady_rev_s(MODEL.motor, np.array([3700.0 * duty]))[0])
        for duty in (1.0, float(motors_and_body(MODEL).hover_duty(3700.0)))
    )
    expected = 2 * min(full**2 - hover**2, hover**2)
    assert most_control(MODEL, "roll") == pytest.approx(expected, rel=0.02)
    assert most_control(MODEL, "yaw") == pytest.approx(2 * expected, rel=0.02)
