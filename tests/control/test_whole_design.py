"""Designs with everything between controller and angle, and gains that no motor follows."""

from pathlib import Path

import numpy as np
import pytest

from groundstation.control.actuators import most_control, reason_not_followed
from groundstation.control.design import OFFSET, OVERSHOOT, SETTLING
from groundstation.control.evaluate import evaluate
from groundstation.control.pid import PidGains
from groundstation.control.search import Budget
from groundstation.control.thesis_loop import Body, counts_per_control, run_whole
from groundstation.control.whole_design import AT_STOPS_S, WINDOW_S, design_whole, whole_limits
from groundstation.dynamics.mixer import PWM_FULL
from groundstation.dynamics.model import THESIS, load_model
from groundstation.errors import BadInputError

MODEL = load_model(Path(__file__).parent / "data" / "body.json")
SMALL = Budget(first=80, population=10, generations=6)


@pytest.fixture(scope="module")
def design():
    (found,) = design_whole(MODEL, ["roll"], whole_limits(), budget=SMALL)
    return found


def test_a_design_keeps_its_limits_and_is_what_the_whole_loop_flies(design):
    (flown,) = evaluate(MODEL, {"roll": design.gains}, "whole", WINDOW_S["roll"])
    assert flown.stable
    assert flown.margins.max_sensitivity <= 2.0
    assert flown.margins.delay_s > 0.002
    assert flown.metrics.settling_s <= design.nominal[SETTLING] + 1e-9
    assert flown.metrics.overshoot_pct <= design.nominal[OVERSHOOT] + 1e-9
    assert design.nominal[OFFSET] <= 0.02


def test_a_design_leaves_the_motors_room(design):
    reference = np.zeros((750, 3))
    reference[:, 0] = 0.2
    three = [design.gains, PidGains(0.0), PidGains(0.0)]
    pwm = run_whole(MODEL, three, reference, Body.RIGID).pwm
    stopped = ((pwm <= 0) | (pwm >= PWM_FULL)).any(axis=1).sum()
    assert stopped * 0.002 <= AT_STOPS_S
    on_control = PidGains(*(g / counts_per_control(MODEL)[0] for g in design.gains.as_tuple()))
    assert reason_not_followed(MODEL, on_control, "roll") == ""


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
    speeds = []
    for thrust in (PWM_FULL, None):
        kept = run_whole(
            MODEL, [PidGains(0.0)] * 3, np.zeros((2000, 3)), Body.RIGID, thrust=thrust
        ).pwm[-1, 0]
        a0, a1, a2 = (getattr(MODEL.motor, name) for name in ("a0", "a1", "a2"))
        speeds.append(np.roots([a2, a1, -a0 * 3700.0 * kept / PWM_FULL]).max())
    full, hover = speeds
    expected = 2 * min(full**2 - hover**2, hover**2)
    assert most_control(MODEL, "roll") == pytest.approx(expected, rel=0.02)
    assert most_control(MODEL, "yaw") == pytest.approx(2 * expected, rel=0.02)


def test_what_no_pid_holds_behind_motors_is_refused_with_what_it_would_take():
    """The printed roll polynomials have a pole that grows by 15 a second; the motors lag 0.1 s."""
    with pytest.raises(BadInputError, match="no gains"):
        design_whole(THESIS, ["roll"], whole_limits(3.0), delay=2, budget=SMALL)
