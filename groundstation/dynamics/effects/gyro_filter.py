"""The firmware's low-pass behind the gyro: w'' = (2 pi f)^2 (rate - w) - sqrt(2) 2 pi f w'.

Source: ``effect.on_board_filter``; 80 Hz on today's crafts.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Reading, butterworth_slopes, on_board_filter


def law(values: Any, craft: Any, body: Any, reading: Any, state: Any) -> Any:
    """(what the gyro shows, slopes of the filtered rates and of their slopes)."""
    shown = (state[0], state[1], state[2])
    slopes = butterworth_slopes(reading.gyro, state, values[0])
    return Reading(shown, reading.accelerometer, reading.rotor), slopes


EFFECT = on_board_filter(
    "gyro_filter",
    law,
    effect.GYRO,
    "gyro",
    corner=(80.0, 20.0),
    longest_s=0.01,
    excited_by=effect.DOUBLETS,
    regimes=effect.TILTING | effect.YAWING | effect.ROTORS | effect.STEADY,
    confused_with=(
        Confusion("dead_time", f"{effect.THRUST_STEPS}: a delay moves the force as well"),
    ),
)
