"""What today's firmware holds constant: gains, thrust curves, filters, by craft."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from firmware_sim.releases import ThrustCurve, curve_of
from groundstation.dynamics.model import Model
from groundstation.dynamics.vehicle import Vehicle

G = 9.80665
LOOP_HZ = 1000.0
GYRO_BANDWIDTH_HZ, ACCELEROMETER_BANDWIDTH_HZ = 116.0, 145.0
"""Of the BMI088's own filters at 1 kHz and 1.6 kHz."""
BUS_S = 0.3e-3

_BRUSHED = {
    "rate_kp": (250.0, 250.0, 120.0),
    "rate_ki": (500.0, 500.0, 16.7),
    "rate_kd": (2.5, 2.5, 0.0),
    "angle_kp": (6.0, 6.0, 6.0),
    "angle_ki": (3.0, 3.0, 1.0),
    "angle_kd": (0.0, 0.0, 0.35),
}
_BRUSHLESS = {**_BRUSHED, "rate_kp": (200.0, 200.0, 120.0), "rate_ki": (400.0, 400.0, 16.7)}
PLATFORMS = ("crazyflie21", "crazyflie21plus", "crazyflie21upgrade", "brushless")
DRAG_PER_S = 0.31
"""Drag of the rotors in their plane, over mass: measured on a 2.1+."""
PWM_STEPS = 256
"""Of the driver of brushed motors, below the 16 bits that the log shows."""
BRUSHLESS_OHM = 1.0
"""Windings of brushless motors are below it, those of brushed ones above."""


def platform_of(vehicle: Vehicle) -> str:
    """The built-in craft whose firmware a vehicle runs."""
    if vehicle.name in PLATFORMS:
        return vehicle.name
    return "brushless" if vehicle.winding_ohm < BRUSHLESS_OHM else "crazyflie21"


def stock_gains(vehicle: Vehicle) -> dict[str, tuple[float, float, float]]:
    """Gains of roll, pitch and yaw by field of the FIRMWARE record."""
    return _BRUSHLESS if platform_of(vehicle) == "brushless" else _BRUSHED


def thrust_curve(vehicle: Vehicle, release: str | None, model: Model | None = None) -> ThrustCurve:
    """The firmware's idea of thrust from motor voltage; that of a model whose flights showed it is
    a model's own."""
    platform = platform_of(vehicle)
    if model is not None and model.firmware_curve is not None:
        return ThrustCurve(model.firmware_curve, curve_of(platform, None).most_n)
    return curve_of(platform, release)


LEAST_THRUST = 20000.0  # 16-bit, of the loop of climb (``platform_defaults_cf2.h``)


def base_thrust(vehicle: Vehicle) -> float:
    """16-bit thrust that the loop of climb begins with; it asks for ``LEAST_THRUST`` or more."""
    return 30000.0 if platform_of(vehicle) == "brushless" else 36000.0


def needs_arming(vehicle: Vehicle) -> bool:
    return platform_of(vehicle) == "brushless"


def idle_pwm(vehicle: Vehicle) -> int:
    """16-bit PWM below which the motors of an armed craft do not go: brushless ones idle, for they
    take long to start."""
    return 7000 if needs_arming(vehicle) else 0


def protection_a(vehicle: Vehicle) -> float:
    """Current at which the cell's protection opens: a brushless craft hovers at 5 A."""
    return 30.0 if platform_of(vehicle) == "brushless" else 4.0


def hover_command(vehicle: Vehicle, curve: ThrustCurve) -> float:
    """16-bit thrust that carries the craft, whatever the battery: what the firmware's curve, which
    need not be the craft's own, makes of the voltage that its motors need."""
    rotor_rev_s = math.sqrt(G / (4 * vehicle.thrust_per_mass))
    volts = vehicle.motor.armature_mv(rotor_rev_s) / 1000.0
    return curve.command(volts)


def low_pass(corner_hz: float) -> NDArray[np.float64]:
    """(b0, b1, b2, a1, a2) of the firmware's second-order Butterworth filter at 1 kHz; of none
    for a corner of 0."""
    if corner_hz == 0.0:
        return np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    warped = math.tan(math.pi * corner_hz / LOOP_HZ)
    scale = 1.0 + 2.0 * math.cos(math.pi / 4.0) * warped + warped**2
    b0 = warped**2 / scale
    a1 = 2.0 * (warped**2 - 1.0) / scale
    a2 = (1.0 - 2.0 * math.cos(math.pi / 4.0) * warped + warped**2) / scale
    return np.array([b0, 2.0 * b0, b0, a1, a2])
