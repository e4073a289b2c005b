"""The firmware's low-pass behind the gyro: w'' = (2 pi f)^2 (rate - w) - sqrt(2) 2 pi f w'.

Source: Butterworth's filter of second order, as today's firmware runs it at 1 kHz (80 Hz,
``sensors_bmi088_bmp3xx.c``). 0 Hz means no filter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from groundstation.dynamics.effect import (
    DOUBLETS,
    GYRO,
    ROTORS,
    STEADY,
    TILTING,
    TIME_CONSTANT,
    YAWING,
    Confusion,
    Effect,
    Parameter,
    State,
)
from groundstation.dynamics.law import Reading


def law(values: Any, craft: Any, body: Any, reading: Any, state: Any) -> Any:
    """(what the gyro shows, slopes of the filtered rates and of their slopes)."""
    pace = 2.0 * math.pi * values[0]
    stiff, damped = pace * pace, math.sqrt(2.0) * pace
    x, y, z = reading.gyro
    return Reading((state[0], state[1], state[2]), reading.accelerometer, reading.rotor), (
        state[3],
        state[4],
        state[5],
        stiff * (x - state[0]) - damped * state[3],
        stiff * (y - state[1]) - damped * state[4],
        stiff * (z - state[2]) - damped * state[5],
    )


def _fastest(values: Mapping[str, float]) -> float:
    return 2.0 * math.pi * values["corner_hz"]


EFFECT = Effect(
    name="gyro_filter",
    stage="sensor",
    law=law,
    states=(
        *(State(f"filtered {axis}", follows=axis) for axis in GYRO),
        *(State(f"slope of filtered {axis}") for axis in GYRO),
    ),
    fastest=_fastest,
    parameters=(
        Parameter(
            "corner_hz",
            "Hz",
            default=80.0,
            low=20.0,
            high=250.0,
            least=0.0,
            unknown=TIME_CONSTANT,
            bounds=(0.0, 0.01),
            step=1e-4,
            stride=1e-3,
        ),
    ),
    adds="the firmware's low-pass of second order behind the gyro; 0 Hz means none",
    signature="the gyro comes late by 1 / (4.4 corner) and shows no faster motion",
    excited_by=DOUBLETS,
    channels=GYRO,
    regimes=TILTING | YAWING | ROTORS | STEADY,
    on_board="gyro_filter_hz",
    confused_with=(Confusion("dead_time", f"{DOUBLETS}: a delay moves the attitude as well"),),
)
