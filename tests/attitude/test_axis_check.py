"""The axis check on the stand-in turned by hand, right and with faults made on purpose."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.attitude.fusion import check_axes
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES
from support.flights import recorded


@pytest.fixture(scope="module")
def turned():
    samples, _ = recorded(
        24.0, program="axis_check", seed=3, sensor={"gyro_bias_dps": (1.0, 2.0, -1.0)}
    )
    return samples


@pytest.fixture(scope="module")
def flight():
    samples, _ = recorded(35.0, program="excite", seed=3)
    return samples[2500:]


def with_column(values, column, factor):
    changed = values.copy()
    changed[:, column] *= factor
    return changed


def test_a_good_craft_passes(turned):
    check = check_axes(turned)
    assert check.verdict == "as_expected"
    assert len(check.findings) == 3 + 2 + 3
    assert all(finding.as_expected for finding in check.findings)


def test_the_firmware_s_own_pitch_is_named_inverted(turned):
    """Thesis 6.3, axis test no. 1: the packet's pitch, before it is negated."""
    as_sent = replace(turned, attitude=with_column(turned.attitude, 1, -1))
    check = check_axes(as_sent)
    assert check.verdict == "wrong_axes"
    assert [str(fault) for fault in check.faults] == ["attitude pitch is inverted"]


@pytest.mark.parametrize("axis", range(3))
def test_an_inverted_gyro_axis_is_named(turned, axis):
    check = check_axes(replace(turned, gyro=with_column(turned.gyro, axis, -1)))
    assert [str(fault) for fault in check.faults] == [f"gyro {AXES[axis]} is inverted"]


@pytest.mark.parametrize("axis", range(2))
def test_an_inverted_accelerometer_axis_is_named(turned, axis):
    column = {0: 1, 1: 0}[axis]
    changed = with_column(turned.accelerometer, column, -1)
    check = check_axes(replace(turned, accelerometer=changed))
    assert [str(fault) for fault in check.faults] == [f"accelerometer {AXES[axis]} is inverted"]


@pytest.mark.parametrize(("one", "other"), [(0, 1), (0, 2), (1, 2)])
def test_swapped_gyro_axes_are_named(turned, one, other):
    order = [0, 1, 2]
    order[one], order[other] = other, one
    check = check_axes(replace(turned, gyro=turned.gyro[:, order]))
    assert {(fault.axis, fault.shown_on) for fault in check.faults} == {
        (AXES[one], AXES[other]),
        (AXES[other], AXES[one]),
    }


def test_a_sensor_turned_by_a_quarter_is_named_axis_by_axis(turned):
    """Mounted a quarter turn about z: x shows y, y shows minus x."""
    gyro = np.column_stack([turned.gyro[:, 1], -turned.gyro[:, 0], turned.gyro[:, 2]])
    faults = {str(fault) for fault in check_axes(replace(turned, gyro=gyro)).faults}
    assert faults == {
        "gyro roll appears on the pitch axis and is inverted",
        "gyro pitch appears on the roll axis",
    }


def test_an_axis_that_was_not_turned_is_called_unclear(turned):
    start = turned.time_s[0]
    without_yaw = turned[turned.time_s < start + 13.8]
    check = check_axes(without_yaw)
    assert check.verdict == "unclear"
    assert any("gyro: hardly moved on yaw" in text for text in check.unclear)


def test_a_flight_is_not_taken_for_the_procedure(flight):
    check = check_axes(flight)
    assert check.verdict != "as_expected"


def test_an_upside_down_start_is_reported(turned):
    changed = with_column(turned.accelerometer, 2, -1)
    check = check_axes(replace(turned, accelerometer=changed))
    assert any("+1 g on z" in text for text in check.unclear)


def test_a_recording_too_short_or_without_a_gyro_is_refused(turned):
    with pytest.raises(BadInputError, match="too short"):
        check_axes(turned[:200])
    missing = replace(turned, gyro=np.full_like(turned.gyro, np.nan))
    with pytest.raises(BadInputError, match="no gyro"):
        check_axes(missing)


def test_a_recording_without_attitude_is_judged_on_the_rest(turned):
    missing = replace(turned, attitude=np.full_like(turned.attitude, np.nan))
    check = check_axes(missing)
    assert not check.faults
    assert any("attitude: not in this recording" in text for text in check.unclear)
