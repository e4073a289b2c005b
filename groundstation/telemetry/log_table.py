"""What a craft logs besides its telemetry: series of their own, at moments of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class LogTable:
    """Some rows of one table.

    host_time_ns: (n,) int64, Unix time at which each came. time_s: (n,) float64 on the device's
    clock. columns: name -> (n,) float64, in the firmware's own unit.
    """

    name: str
    host_time_ns: NDArray[np.int64]
    time_s: NDArray[np.float64]
    columns: dict[str, NDArray[np.float64]]
