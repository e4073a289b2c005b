"""What the base model leaves out between the PWM and the rotors' thrust and torque."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.layout import Record

RADIANS_PER_REVOLUTION = 2.0 * math.pi


@inner
def armature_mv(p: Record, commanded_mv: float) -> float:
    """motor_dead_voltage: friction and driver take their share before the motor turns."""
    if p.dead_mv == 0.0:
        return commanded_mv
    return max(commanded_mv - p.dead_mv, 0.0)


@inner
def rotor_acceleration(p: Record, armature: float, speed: float) -> float:
    """The identified motor (thesis eq. 3.82) in rev/s^2, with what holds it back.

    motor_braking_asymmetry: one switch cannot brake a motor. Below ``start_mv`` a motor at rest
    stays at rest (friction); one that turns goes on turning.
    """
    if armature < p.start_mv and speed < 1.0:
        return -20.0 * speed
    acceleration = p.a0 * armature - p.a1 * speed - p.a2 * speed * speed
    if acceleration < 0.0 and p.braking != 1.0:
        acceleration *= p.braking
    return acceleration


@inner
def motor_supply_mv(
    p: Record, duty: Any, speed: Any, source_mv: float, wire_ohm: float, cell_ohm: float
) -> float:
    """supply_sag: what a source's voltage leaves for the motors.

    Each motor draws duty (u - k n)/R_w with u = duty V, so V = V_s - R I is linear in V. The
    wires' current is reckoned with the bound of the back-EMF constant k, the cell's with the
    true one.
    """
    squares = 0.0
    emf = 0.0
    for i in range(4):
        squares += duty[i] * duty[i]
        emf += duty[i] * speed[i]
    emf_mv = p.back_emf * emf * (wire_ohm + p.emf_share * cell_ohm) / p.winding_ohm
    return (source_mv + emf_mv) / (1.0 + (wire_ohm + cell_ohm) / p.winding_ohm * squares)


@inner
def supply_current(p: Record, duty: Any, speed: Any, motor_mv: float, emf_share: float) -> float:
    """The motors' summed supply current in A at a motor supply voltage in mV."""
    current = 0.0
    for i in range(4):
        current += duty[i] * (duty[i] * motor_mv - emf_share * p.back_emf * speed[i])
    return current / (1000.0 * p.winding_ohm)


@inner
def gyroscopic_torque(p: Record, roll_rate: float, pitch_rate: float, spin_sum: float) -> Any:
    """rotor_gyroscopic_torque in N m on roll and pitch.

    ``spin_sum`` is the sum of spin times speed (rev/s), positive counter-clockwise; the rotors'
    angular momentum h along z gives -Omega x (0, 0, h).
    """
    momentum = p.rotor_inertia_gyro * RADIANS_PER_REVOLUTION * spin_sum
    return -pitch_rate * momentum, roll_rate * momentum


@inner
def acceleration_torque(p: Record, spin_acceleration: float) -> float:
    """rotor_acceleration_torque in N m on yaw: the body takes what the rotors' spin gains."""
    torque: float = -p.rotor_inertia_yaw * RADIANS_PER_REVOLUTION * spin_acceleration
    return torque
