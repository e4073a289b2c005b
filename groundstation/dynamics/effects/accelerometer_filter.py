"""The firmware's low-pass behind the accelerometer: as ``gyro_filter``, of the specific force.

Source: ``on_board_filter.py``; 30 Hz on today's crafts.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import (
    FORCE,
    ROTORS,
    STEADY,
    THRUST,
    THRUST_STEPS,
    TILTING,
    Confusion,
    Reading,
    butterworth_slopes,
    on_board_filter,
)


def law(values: Any, craft: Any, body: Any, reading: Any, state: Any) -> Any:
    """(what the accelerometer shows, slopes of the filtered forces and of their slopes)."""
    shown = (state[0], state[1], state[2])
    slopes = butterworth_slopes(reading.accelerometer, state, values[0])
    return Reading(reading.gyro, shown, reading.rotor), slopes


EFFECT = on_board_filter(
    "accelerometer_filter",
    law,
    FORCE,
    "accelerometer",
    corner=(30.0, 10.0),
    longest_s=0.02,
    order=1,  # of the force where the sensor is
    excited_by=THRUST_STEPS,
    regimes=TILTING | THRUST | ROTORS | STEADY,
    needs=("accelerometer",),
    confused_with=(Confusion("dead_time", f"{THRUST_STEPS}: a delay moves all channels"),),
)
