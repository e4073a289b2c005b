"""Which gains stay once they have flown: those that follow closer, and overshoot hardly more."""

import numpy as np
import pytest

from groundstation.control.metrics import StepMetrics
from groundstation.control.step_analysis import Flown, FlownAxis
from groundstation.learn.story import of_better_axes, told_overshoots

GAINS = {"pid_rate.roll_kp": 300.0, "pid_attitude.roll_kp": 7.0, "pid_rate.yaw_kp": 150.0}


def flown(roll, yaw, predicted=None):
    """(RMS as a share of the step, overshoot in %) of two axes."""

    def axis(name, rms, overshoot):
        said = None if predicted is None else StepMetrics(0.3, predicted, 0.4, 0.0)
        measured = StepMetrics(10.0 * rms, overshoot, 0.4, 0.0)
        return FlownAxis(name, 4, 10.0, measured, np.zeros(10), said)

    return Flown(
        axes=(axis("roll", *roll), axis("yaw", *yaw)), delay_s=0.0, spread_s=0.0, found=4, edges=4
    )


BEFORE = flown((0.40, 5.0), (0.42, 0.0))


@pytest.mark.parametrize(
    ("roll", "yaw", "kept"),
    [
        ((0.30, 9.0), (0.30, 4.0), {"roll", "yaw"}),
        ((0.30, 11.0), (0.30, 4.0), {"yaw"}),
        ((0.41, 0.0), (0.30, 4.0), {"yaw"}),
        ((0.30, 20.0), (0.50, 0.0), set()),
    ],
)
def test_an_axis_keeps_gains_that_follow_closer_and_overshoot_by_five_points_more_at_most(
    roll, yaw, kept
):
    better = of_better_axes(GAINS, BEFORE, flown(roll, yaw))
    assert {name.partition(".")[2].partition("_")[0] for name in better} == kept


def test_both_overshoots_are_told_with_what_was_predicted():
    said = told_overshoots(BEFORE, flown((0.3, 9.0), (0.3, 4.0), predicted=7.0))
    assert said == "overshoot in %: roll 5 to 9 (7 predicted), yaw 0 to 4 (7 predicted)"
