"""What is told of a step response: four numbers, defined here and nowhere else.

With a reference that steps by ``step`` at the first sample of the response y (before it: 0):

- ``rms``: root mean square of reference - y over the whole window, in the unit of y.
- ``overshoot_pct``: how far y goes beyond the reference, in percent of the step; 0 if never.
- ``settling_s``: from the step to the moment after which y stays within 5 % of the step of its
  settled value, the mean over the last tenth of the window. None where y leaves the band in
  that last tenth: it has not settled.
- ``steady_state_error``: reference minus settled value, in the unit of y.

The settled value and not the reference is the band's middle, because a P controller never comes
within 5 % of the reference; how far it stays away is told by the steady-state error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class StepMetrics:
    """See the module's text; ``rms`` and ``steady_state_error`` in the unit of the response."""

    rms: float
    overshoot_pct: float
    settling_s: float | None
    steady_state_error: float

    def as_dict(self) -> dict[str, float | None]:
        """The keys of the design's ``pid evaluate --json``; what is not finite becomes None."""
        numbers = {
            "rms": self.rms,
            "overshoot_pct": self.overshoot_pct,
            "settling_s": self.settling_s,
            "steady_state_error": self.steady_state_error,
        }
        return {k: v if v is not None and math.isfinite(v) else None for k, v in numbers.items()}


def step_metrics(response: ArrayLike, period_s: float, step: float = 1.0) -> StepMetrics:
    """Metrics of a response (k,) to a step of ``step`` at its first sample.

    Raises ValueError for an empty response, a step of zero.
    """
    y = np.asarray(response, np.float64)
    if y.ndim != 1 or len(y) < 10 or step == 0:
        raise ValueError(f"response {y.shape} to a step of {step}: need 10 samples and a step")
    from groundstation.control.linear_loop_kernels import BAND, measure

    out = np.empty(4)
    measure(np.ascontiguousarray(y / step), period_s, BAND, out)
    settling = float(out[2])
    return StepMetrics(
        rms=float(out[0]) * abs(step),
        overshoot_pct=float(out[1]),
        settling_s=None if math.isnan(settling) else settling,
        steady_state_error=float(out[3]) * step,
    )
