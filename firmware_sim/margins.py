"""How far from instability a craft flies: its loops, linearised at hover.

Broken at the motors' input, with everything in the loop: rate and angle gains, the 2 ms hold of
the PWM, the motor's lag ``a1 + 2 a2 n`` and the sensor's age. ``python -m firmware_sim.margins``
prints the table of docs/stand_in.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim.physics import STOCK, craft_of, gain_place
from firmware_sim.settings import StandInSettings
from groundstation.dynamics.vehicle import Vehicle

SENSOR_AGE_S = 3.3e-3
HOLD_S = 1.0e-3
"""Half a pass: the PWM is held."""
BATTERY_MV = 3700.0
DEGREES = 180 / math.pi
Complex = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Margins:
    """crossover_rad_s: where the loop gain falls through 1; phase_deg and delay_s: what may be
    lost there; gain: by what factor it may grow (inf: by any)."""

    crossover_rad_s: float
    phase_deg: float
    delay_s: float
    gain: float


def loop_margins(
    settings: StandInSettings, axis: str, age_s: float = SENSOR_AGE_S, angle_loop: bool = True
) -> Margins:
    """Margins of ``roll`` or ``yaw`` (pitch equals roll) for a craft's gains, as flown.

    age_s: of the gyro and the angles. angle_loop: False looks at the rate loop alone.
    """
    vehicle, _ = craft_of(settings)
    gains = {**vehicle.gains, **settings.gains}
    omega = np.geomspace(0.5, 1500.0, 200_000)
    s = 1j * omega
    rate = _rate_gain(s, gains, settings, axis)
    if axis == "yaw" or not angle_loop:
        controller = rate
    else:
        slow = 0.5 if settings.quirks.attitude_dt else 1.0
        angle = _gain(gains, "angle_kp", 0) + slow * _gain(gains, "angle_ki", 0) / s
        # The angles are refreshed every second pass: 2 ms more on average than the rates.
        controller = rate * (1 + angle / s * np.exp(-2e-3 * s))
    loop = DEGREES * controller * _craft(s, vehicle, axis) * np.exp(-(age_s + HOLD_S) * s)
    return _margins(omega, loop)


def _rate_gain(
    s: Complex, gains: dict[str, float], settings: StandInSettings, axis: str
) -> Complex:
    index = ("roll", "pitch", "yaw").index(axis)
    fast = 3.0 if settings.quirks.clamp_macro else 1.0
    derivative = 0.0 if settings.quirks.clamp_macro else _gain(gains, "rate_kd", index)
    integral = fast * _gain(gains, "rate_ki", index)
    return np.asarray(_gain(gains, "rate_kp", index) + integral / s + derivative * s)


def _gain(gains: dict[str, float], kind: str, index: int) -> float:
    for name, value in gains.items():
        if gain_place(name) == (kind, index):
            return value
    return STOCK[kind][index]


def _craft(s: Complex, vehicle: Vehicle, axis: str) -> Complex:
    """rad/s of the craft per unit of 16-bit PWM."""
    hover = math.sqrt(9.80665 / (4 * vehicle.thrust_per_mass))
    motor = vehicle.motor
    speed = motor.a0 * BATTERY_MV / 65536 / (s + motor.a1 + 2 * motor.a2 * hover)
    c0, _, c2 = vehicle.body_constants
    # Roll reaches two rotors (plus), or four by half (x); yaw reaches all four.
    constant, rotors = (c2, 4.0) if axis == "yaw" else (c0, 2.0)
    return np.asarray(constant * 2 * hover * rotors * speed / s)


def _margins(omega: NDArray[np.float64], loop: Complex) -> Margins:
    size = np.abs(loop)
    last = np.flatnonzero(size > 1)[-1]
    phase_left = float(np.angle(-loop[last]))
    # Beyond the crossover the locus meets the negative real axis where the gain may still grow.
    turned = np.flatnonzero((loop.imag[:-1] < 0) & (loop.imag[1:] >= 0) & (loop.real[1:] < 0))
    gain = min((float(1 / size[k]) for k in turned if k > 0.9 * last), default=math.inf)
    return Margins(
        float(omega[last]), math.degrees(phase_left), phase_left / float(omega[last]), gain
    )


def main() -> None:
    """Print the table."""
    print("| craft | axis | crossover rad/s | phase margin deg | delay margin ms | gain margin |")
    print("|---|---|---|---|---|---|")
    for craft in ("crazyflie1", "crazyflie21", "thesis"):
        for axis in ("roll", "yaw"):
            m = loop_margins(StandInSettings(craft=craft), axis)
            print(
                f"| {craft} | {axis} | {m.crossover_rad_s:.1f} | {m.phase_deg:.0f}"
                f" | {1e3 * m.delay_s:.1f} | {m.gain:.1f} |"
            )


if __name__ == "__main__":
    main()
