"""The brushed motor with its propeller (thesis 3.15): constants, and speed from voltage."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from groundstation.dynamics.vehicle import MotorConstants, Motors
from groundstation.telemetry.arrays import Array

REVOLUTION = 2 * math.pi


def armature_mv(duty: ArrayLike, supply_v: ArrayLike) -> Array:
    """Mean motor voltage in mV of a PWM-driven switch (thesis eq. 3.83-3.84).

    duty: (..., motors) 0..1; supply_v: (...) in V.
    """
    supply_mv = 1000.0 * np.asarray(supply_v, np.float64)
    return np.asarray(duty, np.float64) * supply_mv[..., None]


def simulate_motor(
    motor: MotorConstants | Motors,
    voltage_mv: ArrayLike,
    period_s: float,
    initial_rev_s: ArrayLike | None = None,
    substeps: int = 2,
    effects: Mapping[str, Mapping[str, float]] | None = None,
) -> tuple[Array, Array]:
    """Rotor speeds driven by voltages that are held over each period (thesis eq. 3.82).

    motor: one for all, or each rotor's. voltage_mv: (k, motors), row i acts from sample i to
    i + 1. effects: listed ones of the motors by name, with their parameters.
    initial_rev_s: (motors,), default: at rest at the first voltage's steady speed.

    Returns speeds (k + 1, motors) in rev/s at the samples, and the mean of the squared speed over
    each period (k, motors) in (rev/s)^2, which is what torques are made of.
    """
    from groundstation.dynamics.craft import craft_of_motors
    from groundstation.dynamics.motor_kernels import run_motors

    voltage = np.ascontiguousarray(voltage_mv, np.float64)
    if voltage.ndim != 2 or len(voltage) == 0:
        raise ValueError(f"voltage_mv has shape {voltage.shape}, expected (samples, motors)")
    if initial_rev_s is None:
        start = steady_rev_s(motor, voltage[0])
    else:
        start = np.broadcast_to(np.asarray(initial_rev_s, np.float64), voltage.shape[1:]).copy()
    speed = np.empty((len(voltage) + 1, voltage.shape[1]))
    square = np.empty_like(voltage)
    craft = craft_of_motors(motor, effects or {})
    run_motors(craft[0], voltage, np.zeros(0), period_s, substeps, start, speed, square)
    return speed, square


def each_motor(motor: MotorConstants | Motors, count: int = 4) -> tuple[MotorConstants, ...]:
    """A motor for each of ``count`` rotors, of one for all or of four."""
    return (motor,) * count if isinstance(motor, MotorConstants) else motor


def steady_rev_s(motor: MotorConstants | Motors, armature_mv: Array) -> Array:
    """Speeds (motors,) at which constant armature voltages (motors,) settle."""
    motors = each_motor(motor, len(armature_mv))
    return np.array([one.steady_rev_s(mv) for one, mv in zip(motors, armature_mv, strict=True)])
