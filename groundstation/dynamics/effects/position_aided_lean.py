"""Reported angles of an estimator that positions correct and that takes all force for thrust.

Today's Crazyflie knows its position (motion capture, a deck, a beacon) and lets its Kalman filter
turn the angles until the rotors' axis explains the motion: it predicts the velocity by the force
along that axis alone (``kalman_core.c``, Mueller, Hamer and D'Andrea, 2015). What pushes across it,
drag or a load on a line, is thus taken for a tilt: angles lean into the force, within some tenths
of a second, by the ratio of the two. As a filter of second order, critically damped:

    T^2 e'' = strength (-f_y, f_x) / g - e - 2 T e'      e in roll and pitch, rad
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter, State
from groundstation.telemetry.packet import STANDARD_GRAVITY


def law(values: Any, craft: Any, body: Any, reading: Any, state: Any) -> Any:
    """(the reading as it is, slopes of the lean and of its slopes)."""
    strength, time_s = values
    x, y, turn_x, turn_y = state
    across = strength / STANDARD_GRAVITY
    forward, left, _ = reading.accelerometer
    stiff, damped = 1.0 / (time_s * time_s), 2.0 / time_s
    return reading, (
        turn_x,
        turn_y,
        stiff * (-across * left - x) - damped * turn_x,
        stiff * (across * forward - y) - damped * turn_y,
    )


def _fastest(values: Mapping[str, float]) -> float:
    return 1.0 / values["time_s"]


EFFECT = Effect(
    name="position_aided_lean",
    stage="sensor",
    law=law,
    order=1,  # it reads what the accelerometer shows
    states=(
        State("lean in roll", turns="roll"),
        State("lean in pitch", turns="pitch"),
        State("slope of the lean in roll"),
        State("slope of the lean in pitch"),
    ),
    fastest=_fastest,
    parameters=(
        Parameter(
            "strength",
            "",
            default=1.0,
            low=0.2,
            high=2.0,
            least=0.0,
            bounds=(-0.5, 3.0),
            step=0.05,
            worth=0.3,
        ),
        Parameter(
            "time_s",
            "s",
            default=0.4,
            low=0.1,
            high=2.0,
            absent=0.4,
            kind="shape",
            least=0.02,
            bounds=(0.05, 4.0),
            step=0.01,
        ),
    ),
    adds="reported angles lean into the force across the rotors' axis, 1 by all of it over g,"
    " with this time constant",
    signature="flying steadily, the reported tilt is more than what the accelerometer feels"
    " of gravity says",
    excited_by=f"{effect.TRANSLATE}; positions known, attitude recorded",
    channels=("roll", "pitch"),
    regimes=effect.TRANSLATION,
    needs=("accelerometer", "attitude"),
    confused_with=(
        Confusion(
            "attitude_filter_lean", f"{effect.TRANSLATE}: a Mahony filter creeps to level instead"
        ),
        Confusion("imu_misalignment", f"{effect.HOVER_DOUBLETS}: a misalignment turns at once"),
    ),
)
