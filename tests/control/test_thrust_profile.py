"""Thrust on the motor bench: what is commanded, and what stops it."""

import numpy as np
import pytest

from groundstation.control.programme import (
    RATE_HZ,
    LowBattery,
    ThrustProfile,
    reason_to_stop,
    require_drivable,
)
from groundstation.control.programme import THRUST_SHAPES as SHAPES
from groundstation.errors import BadInputError
from groundstation.telemetry.packet import FULL_16_BIT

AT_REST = {
    "age_s": 0.01, "roll_deg": 31.0, "pitch_deg": -4.0, "gyro_dps": [0.5, -0.2, 0.1],
    "battery_v": 3.9,
}  # fmt: skip


def answer(**changes):
    return {"time_ns": 1, "link_state": "streaming", "telemetry": AT_REST | changes}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_profile_rises_from_motors_off_stays_between_its_limits_and_ends_with_them_off(shape):
    profile = ThrustProfile(shape=shape, low=0.25, high=0.75, seconds=20.0)
    share = profile.thrusts() / FULL_16_BIT
    driven = share[RATE_HZ : -RATE_HZ - 1]
    assert len(driven) == 20 * RATE_HZ
    assert share[0] == share[-1] == 0.0
    assert np.abs(np.diff(share[: RATE_HZ + 1])).max() < 0.01
    assert driven.min() >= 0.25 - 1e-5
    assert driven.max() <= 0.75 + 1e-5
    assert np.ptp(driven) > 0.45


def test_steps_are_others_with_another_seed_and_a_staircase_takes_every_level_both_ways():
    first, again, other = (ThrustProfile(seed=seed).thrusts() for seed in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).any()
    stairs = ThrustProfile(shape="staircase", hold_s=1.0, seconds=28.0).thrusts()
    levels = stairs[RATE_HZ + 50 : -RATE_HZ : RATE_HZ]
    assert np.array_equal(levels[:8], np.unique(levels))
    assert np.array_equal(levels[8:15], levels[6::-1][:7])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"shape": "square"}, "there are steps, staircase, chirp"),
        ({"high": 0.95}, "--high 0.95: must be 0.16..0.9"),
        ({"low": 0.0}, "--low 0: must be"),
        ({"low": 0.5, "high": 0.55}, "0.1 apart at least"),
        ({"seconds": 1000.0}, "--seconds 1000: must be 4..180"),
        ({"hold_s": float("nan")}, "--hold nan"),
    ],
)
def test_what_no_motor_should_be_driven_with_is_refused_with_what_may_be(changed, said):
    with pytest.raises(BadInputError, match=said):
        require_drivable(ThrustProfile(**changed))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, ""),
        ({"roll_deg": 40.0, "gyro_dps": [90.0, 0.0, 0.0]}, ""),
        ({"roll_deg": 55.0}, "tilted by 24 deg since the start: is the craft loose?"),
        ({"gyro_dps": [0.0, 400.0, 0.0]}, "rate of 400 deg/s, 300 is the most: is the craft"),
        ({"battery_v": 2.2}, ""),
        ({"battery_v": None}, "the battery's voltage is not known"),
        ({"age_s": 2.0}, "no telemetry for 2.00 s"),
    ],
)
def test_a_craft_that_comes_loose_an_unknown_battery_or_silence_stop_the_motors(changes, reason):
    said = reason_to_stop(answer(**changes), AT_REST, LowBattery())
    assert said.startswith(reason)
    assert bool(said) == bool(reason)
