"""The firmware's low-pass behind the accelerometer: as ``gyro_filter``, of the specific force.

Source: Butterworth's filter of second order, as today's firmware runs it at 1 kHz (30 Hz,
``sensors_bmi088_bmp3xx.c``). 0 Hz means no filter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from groundstation.dynamics.effect import (
    FORCE,
    ROTORS,
    STEADY,
    THRUST,
    THRUST_STEPS,
    TILTING,
    TIME_CONSTANT,
    Confusion,
    Effect,
    Parameter,
    State,
)
from groundstation.dynamics.law import Reading


def law(values: Any, craft: Any, body: Any, reading: Any, state: Any) -> Any:
    """(what the accelerometer shows, slopes of the filtered forces and of their slopes)."""
    pace = 2.0 * math.pi * values[0]
    stiff, damped = pace * pace, math.sqrt(2.0) * pace
    x, y, z = reading.accelerometer
    return Reading(reading.gyro, (state[0], state[1], state[2]), reading.rotor), (
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
    name="accelerometer_filter",
    stage="sensor",
    law=law,
    order=1,  # of the force where the sensor is
    states=(
        *(State(f"filtered {axis}", follows=axis) for axis in FORCE),
        *(State(f"slope of filtered {axis}") for axis in FORCE),
    ),
    fastest=_fastest,
    parameters=(
        Parameter(
            "corner_hz",
            "Hz",
            default=30.0,
            low=10.0,
            high=250.0,
            least=0.0,
            unknown=TIME_CONSTANT,
            bounds=(0.0, 0.02),
            step=1e-4,
            stride=1e-3,
        ),
    ),
    adds="the firmware's low-pass of second order behind the accelerometer; 0 Hz means none",
    signature="the accelerometer comes late by 1 / (4.4 corner) and shows no faster motion",
    excited_by=THRUST_STEPS,
    channels=FORCE,
    regimes=TILTING | THRUST | ROTORS | STEADY,
    needs=("accelerometer", "modelled rotors"),
    on_board="accelerometer_filter_hz",
    confused_with=(Confusion("dead_time", f"{THRUST_STEPS}: a delay moves all channels"),),
)
