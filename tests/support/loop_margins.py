"""How far from instability a craft flies: its loops, linearised at hover.

Broken at the motors' input, with everything in the loop: rate and angle gains, the 2 ms hold of
the PWM, the motor's lag ``a1 + 2 a2 n`` and the sensor's age.
``python tests/support/loop_margins.py`` prints the table of docs/stand_in.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim import today
from firmware_sim.physics import STOCK, craft_of, firmware_of, gain_place
from firmware_sim.settings import StandInSettings
from groundstation.dynamics.vehicle import Vehicle
from groundstation.telemetry.packet import FULL_16_BIT

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
    is_today = firmware_of(settings, vehicle) == "2.x"
    gain = _gains(settings, vehicle, is_today, ("roll", "pitch", "yaw").index(axis))
    thrice, half = settings.quirks.clamp_macro, settings.quirks.attitude_dt
    fast, slow = (1.0, 1.0) if is_today else (3.0 if thrice else 1.0, 0.5 if half else 1.0)
    omega = np.geomspace(0.5, 1500.0, 200_000)
    s = 1j * omega
    rate = gain["rate_kp"] + fast * gain["rate_ki"] / s
    damping = 0.0 if thrice and not is_today else gain["rate_kd"] * (1 - np.exp(-2e-3 * s)) / 2e-3
    # The angles are refreshed every second pass: 2 ms more on average than the rates.
    angle = (gain["angle_kp"] + slow * gain["angle_ki"] / s) / s * np.exp(-2e-3 * s)
    if is_today:
        # today's derivatives are those of what is measured
        angle = angle + gain["angle_kd"] * np.exp(-2e-3 * s)
    if not angle_loop or (axis == "yaw" and not is_today):
        angle = np.zeros_like(s)
    controller = rate * (1 + angle) + damping * (1.0 if is_today else 1 + angle)
    craft = _craft(s, vehicle, axis, _millivolts(vehicle, is_today))
    return _margins(omega, DEGREES * controller * craft * np.exp(-(age_s + HOLD_S) * s))


def _gains(
    settings: StandInSettings, vehicle: Vehicle, is_today: bool, index: int
) -> dict[str, float]:
    """Those of one axis, by field of the FIRMWARE record."""
    stock = today.stock_gains(vehicle) if is_today else STOCK
    gains = {kind: values[index] for kind, values in stock.items()}
    for name, value in {**vehicle.gains, **settings.gains}.items():
        kind, axis = gain_place(name)
        if axis == index and kind in gains:
            gains[kind] = value
    return gains


def _millivolts(vehicle: Vehicle, is_today: bool) -> float:
    """Motor voltage (mV) for one more 16-bit unit of the controller's output, at hover."""
    if not is_today:
        return BATTERY_MV / 65536
    curve, most_n = today.thrust_curve(vehicle)
    volts = vehicle.motor.armature_mv(_hover_rev_s(vehicle)) / 1000.0
    slope = sum(
        power * factor * volts ** (power - 1) for power, factor in enumerate(curve) if power
    )
    return 1000.0 * most_n / FULL_16_BIT / slope


def _hover_rev_s(vehicle: Vehicle) -> float:
    return math.sqrt(9.80665 / (4 * vehicle.thrust_per_mass))


def _craft(s: Complex, vehicle: Vehicle, axis: str, millivolts: float) -> Complex:
    """rad/s of the craft per unit of the controller's output."""
    hover, motor = _hover_rev_s(vehicle), vehicle.motor
    speed = motor.a0 * millivolts / (s + motor.a1 + 2 * motor.a2 * hover)
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
