"""What today's firmware changed from release to release: how thrust becomes motor voltage."""

from __future__ import annotations

import math
from dataclasses import dataclass

from groundstation.telemetry.packet import FULL_16_BIT

PROTOCOLS_OF = {
    "2023.11": 7,
    "2024.10": 8,
    "2025.02": 9,
    "2025.09": 10,
    "2025.12": 10,
    "2026.04": 12,
    "2026.08": 12,
}
"""Release -> its version of CRTP."""
BEGINS_ANEW = "2026.08"
"""The release from which on its loops begin anew with another kind of setpoint."""

_LEGACY = (-0.014831, 0.047245, -0.018474, 0.0059609)
_PLUS = (-0.024765, 0.065238, -0.026793, 0.0067768)
_UPGRADE = (0.0067281, 0.010116, 0.010263, 0.0028358)
_UPGRADE_2025 = (-0.039782, 0.109797, -0.055453, 0.016215)
_BRUSHLESS = (-0.014059, 0.042653, 0.0018328, 0.0020577)
GRAMS, VOLTS_OF_GRAMS = 60.0, (0.088, -0.0006239)
"""Until 2025.02: grams at full thrust, and volts per gram and per square gram."""


@dataclass(frozen=True, slots=True)
class ThrustCurve:
    """newtons: of a motor, from its voltage (constant, linear, ...). most_n: full thrust; less than
    least_n is none. by_grams: the curve of ``VOLTS_OF_GRAMS`` instead. battery: the voltage of the
    battery is reckoned with."""

    newtons: tuple[float, ...] = _LEGACY
    most_n: float = 0.12
    least_n: float = 0.0
    by_grams: bool = False
    battery: bool = True

    def command(self, volts: float) -> float:
        """16-bit thrust that gives a motor so many volts; at 3.7 V where it depends on that."""
        if not self.battery:
            return volts / 3.7 * FULL_16_BIT
        if self.by_grams:
            linear, square = VOLTS_OF_GRAMS
            grams = (math.sqrt(linear**2 + 4.0 * square * volts) - linear) / (2.0 * square)
            return grams / GRAMS * FULL_16_BIT
        newtons = sum(factor * volts**power for power, factor in enumerate(self.newtons))
        return newtons / self.most_n * FULL_16_BIT


_OF_2026 = {
    "crazyflie21": ThrustCurve(_LEGACY, 0.12),
    "crazyflie21plus": ThrustCurve(_PLUS, 0.12),
    "crazyflie21upgrade": ThrustCurve(_UPGRADE, 0.18),
    "brushless": ThrustCurve(_BRUSHLESS, 0.2),
}
"""Each craft's own curve, down to no thrust: what the design of gains reckons with."""


def curve_of(platform: str, release: str | None) -> ThrustCurve:
    """What the image of a release makes of thrust, the same for a 2.1 and a 2.1+; without a release
    the craft's own."""
    if release is None:
        return _OF_2026[platform]
    if platform == "brushless":
        if release <= "2025.09":
            return ThrustCurve(battery=False)
        return ThrustCurve(_BRUSHLESS, 0.2, 0.02136)
    if release <= "2025.02":
        return ThrustCurve(by_grams=True)
    if platform == "crazyflie21upgrade":
        if release <= "2025.12":
            return ThrustCurve(_UPGRADE_2025, 0.1625, 0.03)
        return ThrustCurve(_UPGRADE, 0.18, 0.01923)
    if release <= "2025.12":
        return ThrustCurve(_LEGACY if release == "2025.09" else _PLUS, 0.1125, 0.02)
    return ThrustCurve(_PLUS, 0.12, 0.01282)
