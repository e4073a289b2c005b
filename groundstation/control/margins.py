"""How far a loop is from instability, from its frequency response (python-control)."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

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
        """For JSON: what is infinite becomes None."""
        return {k: v if math.isfinite(v) else None for k, v in asdict(self).items()}


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
