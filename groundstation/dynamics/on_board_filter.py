"""Effects of the low-passes that today's firmware runs behind its sensors: what they share.

Butterworth's filter of second order (``law.butterworth_slopes``), at 1 kHz on board
(``sensors_bmi088_bmp3xx.c``). 0 Hz means no filter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effect import TIME_CONSTANT, Channel, Effect, Law, Parameter, State

LOOP_S = 1e-3
"""How often the firmware runs it."""


def on_board_filter(
    name: str,
    law: Law,
    channels: tuple[Channel, ...],
    behind: str,
    corner: tuple[float, float],
    longest_s: float,
    **more: Any,
) -> Effect:
    """The effect of a filter behind ``behind`` (in words), which shows in its three ``channels``.

    corner: usual one and lowest, Hz. longest_s: time constant that a fit may reach. more: further
    fields of the ``Effect``.
    """
    usual_hz, lowest_hz = corner
    return Effect(
        name=name,
        stage="sensor",
        law=law,
        states=(
            *(State(f"filtered {axis}", follows=axis) for axis in channels),
            *(State(f"slope of filtered {axis}") for axis in channels),
        ),
        fastest=_fastest,
        parameters=(
            Parameter(
                "corner_hz",
                "Hz",
                default=usual_hz,
                low=lowest_hz,
                high=250.0,
                least=0.0,
                unknown=TIME_CONSTANT,
                bounds=(0.0, longest_s),
                step=1e-4,
            ),
        ),
        adds=f"the firmware's low-pass of second order behind the {behind}; 0 Hz means none",
        signature=f"the {behind} comes late by 1 / (4.4 corner) and shows no faster motion",
        channels=channels,
        on_board=f"{name}_hz",
        **more,
    )


def power_passed(hz: NDArray[np.float64], corner_hz: float) -> NDArray[np.float64]:
    """Share of a vibration's power that is left behind such a filter as the firmware runs it, by
    the bilinear transform (Oppenheim and Schafer); corner 0: all of it."""
    if corner_hz <= 0.0:
        return np.ones_like(hz)
    ratio = np.tan(math.pi * hz * LOOP_S) / math.tan(math.pi * corner_hz * LOOP_S)
    return np.asarray(1.0 / (1.0 + ratio**4), np.float64)


def _fastest(values: Mapping[str, float]) -> float:
    return 2.0 * math.pi * values["corner_hz"]
