"""The cell and the firmware's view of it."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_sim import battery
from firmware_sim.craft import StandInSettings
from firmware_sim.layout import STATE
from firmware_sim.physics import firmware
from support.plant import callable_piece, plant

TABLE_V = [3.00, 3.78, 3.83, 3.87, 3.89, 3.92, 3.96, 4.00, 4.04, 4.10]
"""The firmware's charge table, 0..90 % in steps of 10 %."""


def test_the_open_circuit_voltage_is_the_firmwares_charge_table():
    kernel = callable_piece(battery.open_circuit_v)
    charges = np.linspace(0.0, 0.9, 10)
    assert [kernel(charge) for charge in charges] == pytest.approx(TABLE_V)
    assert [battery.open_circuit_mv(c) / 1e3 for c in charges] == pytest.approx(TABLE_V)
    assert kernel(0.15) == pytest.approx((3.78 + 3.83) / 2)
    assert 4.10 < kernel(1.0) <= 4.20


def test_the_reading_follows_a_step_with_155_ms():
    p, _ = plant(plant="faithful")
    fw, s = firmware(StandInSettings()), np.zeros(1, STATE)
    s["rng"] = np.arange(1, 9).reshape(4, 2)
    read = callable_piece(battery.read_adc)
    s["reported_mv"] = 4000.0
    read(p[0], fw[0], s[0])
    assert fw["battery_filter"][0] == pytest.approx(4.0, abs=0.005)
    s["reported_mv"] = 3500.0
    readings = []
    for _ in range(100):  # 100 Hz
        read(p[0], fw[0], s[0])
        readings.append(fw["battery_filter"][0])
    fallen = (4.0 - np.array(readings)) / 0.5
    assert 0.01 * (np.argmax(fallen > 1 - np.exp(-1)) + 1) == pytest.approx(0.155, abs=0.011)
    assert readings[-1] == pytest.approx(3.5, abs=0.005)


def states(volts: float, seconds: float) -> tuple[int, bool]:
    """(power state, shutdown asked for) after a voltage has lasted."""
    fw = firmware(StandInSettings())
    manage = callable_piece(battery.manage_power)
    fw["battery_filter"] = 3.7
    manage(fw[0], 0)
    fw["battery_filter"] = volts
    down = False
    for ms in range(2, round(seconds * 1000) + 1, 2):
        down = manage(fw[0], ms * 1_000_000)
    return int(fw["power_state"][0]), bool(down)


def test_low_is_5_s_below_3_2_v_and_critical_5_s_below_3_0_v():
    assert states(3.21, 8.0) == (0, False)
    assert states(3.19, 4.9) == (0, False)
    assert states(3.19, 5.1) == (3, False)
    assert states(2.99, 4.9) == (0, False)
    assert states(2.99, 5.1) == (3, True)


def test_the_protection_opens_beyond_4_a_but_not_at_a_spike():
    p, s = plant(plant="faithful")
    protect = callable_piece(battery.protect)
    s["current_a"] = 3.9
    assert not any(protect(p[0], s[0]) for _ in range(100))
    s["current_a"] = 4.1
    assert not protect(p[0], s[0])
    s["current_a"] = 3.0
    assert not protect(p[0], s[0])
    s["current_a"] = 4.1
    assert [protect(p[0], s[0]) for _ in range(5)] == [False, False, False, True, True]
