"""What a loop achieves: its margins, and the figures of its steps."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

# How far a loop is from instability, from its frequency response (python-control).


Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Margins:
    """max_sensitivity: max |1/(1+L)|, the inverse of the locus's distance from -1.
    gain_up, gain_down: factors by which the gain may grow (inf: any) or fall (0: any).
    phase_deg: smallest phase that may be lost. delay_s: smallest delay that makes it unstable.
    crossover_rad_s: the highest frequency at which |L| = 1.

    They hold for a loop that is stable; whether it is, a frequency response cannot tell alone.
    """

    max_sensitivity: float
    gain_up: float
    gain_down: float
    phase_deg: float
    delay_s: float
    crossover_rad_s: float

    def as_dict(self) -> dict[str, float | None]:
        """The keys of ``MARGINS``, for JSON: what is infinite becomes None."""
        found = {key: getattr(self, name) for key, name in MARGINS.items()}
        return {key: v if math.isfinite(v) else None for key, v in found.items()}


MARGINS = {
    "max_sensitivity": "max_sensitivity",
    "delay_margin_s": "delay_s",
    "gain_up": "gain_up",
    "gain_down": "gain_down",
    "phase_margin_deg": "phase_deg",
}
"""Margins as ``pid --json`` tells them, by key."""


@dataclass(frozen=True, slots=True)
class LoopResponse:
    """A loop broken at one place: L (n,) at rising frequencies omega (n,) in rad/s."""

    omega: NDArray[np.float64]
    loop: Complex

    @property
    def margins(self) -> Margins:
        return loop_margins(self.loop, self.omega)

    @property
    def sensitivities(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """|1/(1+L)| and |L/(1+L)|, (n,) each: what is left of a push, and what of a reference or
        of noise comes through."""
        import control

        response = control.frd(self.loop, self.omega, smooth=False)
        shown = [control.feedback(*pair) for pair in ((1, response), (response, 1))]
        left, through = (np.abs(one.frdata[0, 0]) for one in shown)
        return np.asarray(left), np.asarray(through)


def loop_margins(loop: Complex, omega: NDArray[np.float64]) -> Margins:
    """Margins of a loop response L (n,) at rising frequencies omega (n,) in rad/s.

    The grid must be dense enough for linear interpolation between its points.
    """
    import control

    response = control.frd(loop, omega)
    gains, _, _, at_phase, at_gain, _ = control.stability_margins(response, returnall=True)
    gains = np.asarray(gains)[np.asarray(at_phase) > 0]
    if loop[0].real < -1 and abs(loop[0].imag) < -0.1 * loop[0].real:
        gains = np.append(gains, -1.0 / loop[0].real)  # the locus begins left of -1
    crossings = np.asarray(at_gain)
    away = np.unwrap(np.angle(loop))
    # Rotating L clockwise meets -1 after this angle, whatever the winding so far.
    left = np.mod(np.interp(crossings, omega, away) + math.pi, 2 * math.pi)
    lost = np.minimum(left, 2 * math.pi - left)
    return Margins(
        max_sensitivity=float(1.0 / np.min(np.abs(1.0 + loop))),
        gain_up=float(min((g for g in gains if g > 1), default=math.inf)),
        gain_down=float(max((g for g in gains if 0 < g < 1), default=0.0)),
        phase_deg=math.degrees(float(lost.min())) if len(lost) else math.inf,
        delay_s=float(np.min(left / crossings)) if len(left) else math.inf,
        crossover_rad_s=float(crossings.max()) if len(crossings) else 0.0,
    )


# What is told of a step response: four numbers, defined here and nowhere else.
#
# With a reference that steps by ``step`` at the first sample of the response y (before it: 0):
#
# - ``rms``: root mean square of reference - y over the whole window, in the unit of y.
# - ``overshoot_pct``: how far y goes beyond the reference, in percent of the step; 0 if never.
# - ``settling_s``: from the step to the moment after which y stays within 5 % of the step of its
#   settled value, the mean over the last tenth of the window. None where y leaves the band in
#   that last tenth: it has not settled.
# - ``steady_state_error``: reference minus settled value, in the unit of y.
#
# The settled value and not the reference is the band's middle, because a P controller never comes
# within 5 % of the reference; how far it stays away is told by the steady-state error.


@dataclass(frozen=True, slots=True)
class StepMetrics:
    """See the module's text; ``rms`` and ``steady_state_error`` in the unit of the response."""

    rms: float
    overshoot_pct: float
    settling_s: float | None
    steady_state_error: float

    def as_dict(self) -> dict[str, float | None]:
        """The keys of the design's ``pid evaluate --json``; what is not finite becomes None."""
        numbers = asdict(self).items()
        return {k: v if v is not None and math.isfinite(v) else None for k, v in numbers}


def step_metrics(response: ArrayLike, period_s: float, step: float = 1.0) -> StepMetrics:
    """Metrics of a response (k,) to a step of ``step`` at its first sample.

    Raises ValueError for an empty response, a step of zero.
    """
    y = np.asarray(response, np.float64)
    if y.ndim != 1 or len(y) < 10 or step == 0:
        raise ValueError(f"response {y.shape} to a step of {step}: need 10 samples and a step")
    from groundstation.control.kernels import BAND, measure

    out = np.empty(4)
    measure(np.ascontiguousarray(y / step), period_s, BAND, out)
    settling = float(out[2])
    return StepMetrics(
        rms=float(out[0]) * abs(step),
        overshoot_pct=float(out[1]),
        settling_s=None if math.isnan(settling) else settling,
        steady_state_error=float(out[3]) * step,
    )
