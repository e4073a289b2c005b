"""Setpoints and their age: what arrives from a client or the pilot, and when it goes stale."""

from __future__ import annotations

from firmware_sim.compiled import inner
from firmware_sim.layout import Record
from groundstation.telemetry.packet import FULL_16_BIT

MIN_THRUST = 10000.0
MIN_THRUST_TODAY = 1000.0
MAX_THRUST = 60000.0
LEVEL_NS = 500_000_000
"""Without a setpoint for so long: level, no yaw rate, thrust kept."""
STOP_NS = 2_000_000_000
"""Without a setpoint for so long: motors off."""


@inner
def accept(fw: Record, now_ns: int, roll: float, pitch: float, yaw: float, thrust: float) -> None:
    """Take a setpoint: deg, deg (nose up), deg/s (clockwise), 16-bit thrust."""
    fw.setpoint[0] = roll
    fw.setpoint[1] = pitch
    fw.setpoint[2] = yaw
    fw.setpoint_thrust = thrust
    fw.holds_height = fw.holds_climb = fw.holds_speed = 0
    fw.setpoint_ns = now_ns


@inner
def watch(fw: Record, now_ns: int) -> None:
    """Act on the age of the last setpoint and set the thrust of this pass."""
    age = now_ns - fw.setpoint_ns
    if age > LEVEL_NS:
        fw.setpoint[0] = 0.0
        fw.setpoint[1] = 0.0
        fw.setpoint[2] = 0.0
        fw.holds_speed = 0
    if age > STOP_NS:
        fw.setpoint_thrust = 0.0
        fw.holds_height = fw.holds_climb = 0
    fw.thrust = 0.0
    least = MIN_THRUST_TODAY if fw.today != 0 else MIN_THRUST
    if fw.setpoint_thrust > least:
        # the loops of height and climb go on to full thrust
        held = fw.holds_height + fw.holds_climb > 0 and fw.today != 0
        fw.thrust = min(fw.setpoint_thrust, FULL_16_BIT if held else MAX_THRUST)
