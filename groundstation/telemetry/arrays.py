"""What all packages share of arrays: their type, and the names of the three axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
AXES = ("roll", "pitch", "yaw")
"""About x (forward), y (to the left) and z (up), in this order wherever three numbers stand."""
