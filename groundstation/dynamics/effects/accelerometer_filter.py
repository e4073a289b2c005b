"""The firmware's low-pass behind the accelerometer: as ``gyro_filter``, of the specific force.

Source: ``effect.on_board_filter``; 30 Hz on today's crafts.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics import effect
from groundstation.dynamics.effect import Confusion, Reading, butterworth_slopes, on_board_filter


def law(values: Any, craft: Any, body: Any, reading: Any, state: Any) -> Any:
    """(what the accelerometer shows, slopes of the filtered forces and of their slopes)."""
    shown = (state[0], state[1], state[2])
    slopes = butterworth_slopes(reading.accelerometer, state, values[0])
    return Reading(reading.gyro, shown, reading.rotor), slopes


EFFECT = on_board_filter(
    "accelerometer_filter",
    law,
    effect.FORCE,
    "accelerometer",
    corner=(30.0, 10.0),
    longest_s=0.02,
    order=1,  # of the force where the sensor is
    excited_by=effect.THRUST_STEPS,
    regimes=effect.TILTING | effect.THRUST | effect.ROTORS | effect.STEADY,
    needs=("accelerometer",),
    confused_with=(Confusion("dead_time", f"{effect.THRUST_STEPS}: a delay moves all channels"),),
)
