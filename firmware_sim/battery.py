"""The cell, its protection, and what the firmware reads of it.

Terminal voltage = open-circuit voltage of the charge left, less the internal resistance times
the current. The cell delivers the motors' supply current by their true back-EMF constant, and
the electronics'. The wires to the motors drop what ``supply_sag`` is defined by: the current by
the bound a1/a0, which is smaller (see ``effects.rotors``). All is taken once a pass and held
over it.
"""

from __future__ import annotations

import math

import numpy as np

from firmware_sim.compiled import inner
from firmware_sim.effects.supply_sag import motor_supply_mv, supply_current
from firmware_sim.layout import PASS_NS, ROTOR, SENSOR_STREAM, Record
from firmware_sim.random_numbers import normal

OPEN_CIRCUIT_V = (3.00, 3.78, 3.83, 3.87, 3.89, 3.92, 3.96, 4.00, 4.04, 4.10, 4.18)
"""At 0, 10 .. 100 % of charge, one lithium-polymer cell."""
ADC_STEP_V = 0.002
ADC_NOISE_V = 0.001
ADC_FILTER = 1.0 / 16.0
ADC_PASSES = 5
PROTECTION_NS = 6_000_000
"""How long the protection tolerates too much current."""
LOW_V, CRITICAL_V = 3.2, 3.0
PATIENCE_NS = 5_000_000_000


@inner
def open_circuit_v(charge: float) -> float:
    """Open-circuit voltage at a charge of 0..1 (linear between the table's points)."""
    place = min(max(charge, 0.0), 1.0) * 10.0
    index = min(int(place), 9)
    share = place - index
    return OPEN_CIRCUIT_V[index] * (1.0 - share) + OPEN_CIRCUIT_V[index + 1] * share


def open_circuit_mv(charge: float) -> float:
    """The same for the interpreter, mV."""
    return float(1000 * np.interp(charge, np.linspace(0, 1, 11), OPEN_CIRCUIT_V))


@inner
def supply(p: Record, s: Record) -> None:
    """Set the voltage that drives the motors over the coming pass, and use up charge.

    Leaves ``s.supply_mv`` (at the motors), ``s.reported_mv`` (at the terminals, after the
    reading's lag where there is one) and ``s.current_a``.
    """
    speed = s.y[ROTOR : ROTOR + 4]
    if p.stiff_mv > 0.0:
        s.supply_mv = motor_supply_mv(p, s.duty, speed, p.stiff_mv, p.supply_ohm, 0.0)
    else:
        source_mv = 1000.0 * (open_circuit_v(s.charge) - p.internal_ohm * p.electronics_a)
        s.supply_mv = motor_supply_mv(p, s.duty, speed, source_mv, p.supply_ohm, p.internal_ohm)
    bound_a = supply_current(p, s.duty, speed, s.supply_mv, 1.0)
    terminal = s.supply_mv + 1000.0 * p.supply_ohm * bound_a
    motors_a = supply_current(p, s.duty, speed, s.supply_mv, p.emf_share)
    s.current_a = max(motors_a, 0.0) + p.electronics_a
    if p.stiff_mv == 0.0:
        s.charge = max(s.charge - s.current_a * PASS_NS * 1e-9 / p.capacity_c, 0.0)
    if p.reading_lag > 0.0:
        gain = 1.0 - math.exp(-PASS_NS * 1e-9 / p.reading_lag)
        s.reported_mv += gain * (terminal - s.reported_mv)
    else:
        s.reported_mv = terminal


@inner
def protect(p: Record, s: Record) -> bool:
    """Whether the cell's protection has opened: too much current for too long."""
    if p.protection_a > 0.0 and s.current_a > p.protection_a:
        s.overload_ns += PASS_NS
    else:
        s.overload_ns = 0
    return bool(s.overload_ns > PROTECTION_NS)


@inner
def read_adc(p: Record, fw: Record, s: Record) -> None:
    """The firmware's own reading: 100 Hz, 2 mV steps, a slow first-order filter."""
    if p.adc_filter == 0:
        fw.battery_filter = s.reported_mv * 1e-3
        return
    volts = s.reported_mv * 1e-3 + ADC_NOISE_V * normal(s.rng, SENSOR_STREAM)
    volts = math.floor(volts / ADC_STEP_V + 0.5) * ADC_STEP_V
    if fw.battery_filter == 0.0:
        fw.battery_filter = volts
    fw.battery_filter += ADC_FILTER * (volts - fw.battery_filter)


@inner
def manage_power(fw: Record, now_ns: int) -> bool:
    """Low-battery state after 5 s below 3.2 V; True when 5 s below 3.0 V ask for a shutdown."""
    if fw.battery_filter >= LOW_V:
        fw.low_ns = now_ns
    elif now_ns - fw.low_ns > PATIENCE_NS:
        fw.power_state = 3
    if fw.battery_filter >= CRITICAL_V:
        fw.critical_ns = now_ns
    return bool(now_ns - fw.critical_ns > PATIENCE_NS)
