"""Which Crazyflie a file is from, as far as its names and ranges tell.

A file that was not made here does not name its craft. What it holds may still exclude the Crazyflie
1.0, whose profile is the default: ``family_of`` says so, and ``fit`` and the others then ask.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch

TODAY = "2.x"
"""A Crazyflie 2.x or Brushless; which of them, no log says."""
UNKNOWN = "unknown"

_TODAYS_GROUPS = frozenset(
    {"stateEstimate", "stateEstimateZ", "kalman", "ctrltarget", "controller", "rpm", "pwm"}
)
"""Groups of log variables that the firmware of 2014 does not have."""
_TODAYS_NAMES = frozenset({"pm.vbatMV", "motor.m1req", "motor.m1_rpm"})
_MOST_G_OF_1 = 8.0 * np.sqrt(3.0) * 1.01
"""The 1.0 measures to 8 g an axis, a 2.x to 24 g."""


def family_of(names: Collection[str], samples: SampleBatch) -> dict[str, str]:
    """The ``vehicle`` metadata of a file that names no craft: its family, and why.

    names: variables or columns as the file spells them.
    """
    by_name = sorted(
        name
        for name in names
        if (name.split(".")[0] in _TODAYS_GROUPS and "." in name) or name in _TODAYS_NAMES
    )
    if by_name:
        return {"family": TODAY, "because": f"only a 2.x logs {by_name[0]}"}
    force = samples.accelerometer[np.isfinite(samples.accelerometer).all(axis=1)]
    most_g = float(np.linalg.norm(force, axis=1).max(initial=0.0)) / STANDARD_GRAVITY
    if most_g > _MOST_G_OF_1:
        return {"family": TODAY, "because": f"{most_g:.0f} g are beyond a 1.0's sensor"}
    return {"family": UNKNOWN, "because": "the file does not say"}
