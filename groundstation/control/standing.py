"""Whether a craft stands on the floor, before its motors turn."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from groundstation.control.flight_watch import largest

STAND_S = 3.0
STILL_DPS, LEVEL_DEG = 5.0, 10.0
"""A hand never holds a craft so still; nobody puts one on a steeper floor."""
FLOOR_M = 0.1
"""A craft's own height on the floor is known to some cm."""


class Standing:
    """Watches a craft whose motors stand still; ``trouble``: why it may not take off, or empty."""

    def __init__(self) -> None:
        self.trouble = ""
        self._since_s = math.inf

    def look(self, now_s: float, answer: Mapping[str, Any]) -> bool:
        """Whether it has stood for ``STAND_S``, by this answer and those before it."""
        self.trouble = trouble_of(answer)
        self._since_s = math.inf if self.trouble else min(self._since_s, now_s)
        return now_s - self._since_s >= STAND_S


def trouble_of(answer: Mapping[str, Any]) -> str:
    """Why a craft does not stand still, level, on the floor and ready to fly, or empty. answer: the
    daemon's to a setpoint; a height of None is not known, and any angle that is missing is a
    reason."""
    said, height_m = answer["telemetry"], answer.get("height_m")
    if answer.get("hindrance"):
        return str(answer["hindrance"])
    turns = largest(said["gyro_dps"])
    if not turns <= STILL_DPS:
        return f"it moves ({turns:.0f} deg/s, {STILL_DPS:g} is the most): put it on the floor"
    tilt = largest((said["roll_deg"], said["pitch_deg"]))
    if not tilt <= LEVEL_DEG:
        return f"it is tilted by {tilt:.0f} deg, {LEVEL_DEG:g} is the most: put it on level floor"
    if height_m is not None and not abs(height_m) <= FLOOR_M:
        return (
            f"it is {height_m:.2f} m above the floor: put it down; where a positioning system tells"
            " its height, set the origin on the floor"
        )
    return ""
