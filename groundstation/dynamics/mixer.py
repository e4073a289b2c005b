"""From rotors to torques (thesis 3.8-3.9, 7.19), and what PWM counts are of (8.2).

Rotors are numbered as in the vehicle profile; M1 and M3 turn counter-clockwise seen from above.
In the X configuration each rotor acts on roll and pitch with the lever arm / sqrt(2), which the
profile's body constants contain.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from groundstation.telemetry.arrays import Array

Configuration = Literal["plus", "x"]

PWM_FULL = 4096.0
"""PWM counts of 100 % duty (thesis 8.2.5)."""

MIXERS: dict[str, Array] = {
    "plus": np.array([[0, -1, 0, 1], [-1, 0, 1, 0], [-1, 1, -1, 1]], np.float64),
    "x": np.array([[-1, -1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]], np.float64),
}
"""Rows u'1, u'2, u'3 over squared rotor speeds: thesis eq. 7.19, and the same for X."""
