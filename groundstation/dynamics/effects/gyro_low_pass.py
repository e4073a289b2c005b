"""A first-order lag of the gyro: d gyro/dt = (rate - gyro) 2 pi bandwidth.

Source: the MPU-6050's digital low-pass (data sheet, register 26), and any filter of a firmware.
0 Hz means no lag.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Effect, Parameter, Reading, State

WIDEST_S = 0.98e-3
"""Delay of the chip's widest setting, 256 Hz (data sheet, register 26)."""


def law(values: Any, craft: Any, body: Any, reading: Any, state: Any) -> Any:
    """(what the gyro shows, slopes of the lagged rates)."""
    pace = 2.0 * math.pi * values[0]
    x, y, z = reading.gyro
    return Reading((state[0], state[1], state[2]), reading.accelerometer, reading.rotor), (
        pace * (x - state[0]),
        pace * (y - state[1]),
        pace * (z - state[2]),
    )


def _fastest(values: Mapping[str, float]) -> float:
    return 2.0 * math.pi * values["bandwidth_hz"]


EFFECT = Effect(
    name="gyro_low_pass",
    stage="sensor",
    law=law,
    states=tuple(State(f"lagged {axis}", follows=axis) for axis in effect.GYRO),
    fastest=_fastest,
    parameters=(
        Parameter(
            "bandwidth_hz",
            "Hz",
            default=30.0,
            low=4.0,
            high=400.0,
            least=0.0,
            unknown=effect.TIME_CONSTANT,
            bounds=(0.0, 0.05),
            step=1e-4,
            stride=3e-3,
            near=3e-4,
        ),
    ),
    adds="the gyro lags the true rate, first order; 0 Hz means no lag",
    signature="the gyro comes after the attitude that is its integral; fast motion is attenuated",
    excited_by=effect.DOUBLETS,
    channels=effect.GYRO,
    regimes=effect.TILTING | effect.YAWING | effect.ROTORS | effect.STEADY,
    negligible=WIDEST_S,
    because="the chip is that late with its low-pass wide open (MPU-6050 data sheet, register 26)",
    confused_with=(
        Confusion("dead_time", f"{effect.DOUBLETS}: a delay moves the attitude as well"),
    ),
)
