"""Height by today's firmware: what it makes of a Z-ranger, and the loops that hold it.

Loops and gains: ``position_controller_pid.c``, ``platform_defaults_cf2.h`` (2.0 and 0.5 on height,
25 and 15 on climb, thrust of 36000 to begin with, 20000 at least). The estimator stands for the
firmware's Kalman filter: acceleration, corrected by each range.
"""

from __future__ import annotations

import math

from firmware_sim.compiled import inner
from firmware_sim.layout import PASS_NS, SENSOR_STREAM, Record
from firmware_sim.random_numbers import normal
from groundstation.telemetry.packet import FULL_16_BIT

DT = PASS_NS * 1e-9
RANGE_PASSES, LOOP_PASSES = 13, 5
"""Between two ranges (the sensor's 26 ms) and two passes of the loops (100 Hz)."""
RANGE_NOISE_M, MOST_RANGE_M = 0.003, 4.0
HEIGHT_SHARE, CLIMB_SHARE = 0.25, 1.2
"""Of what a range tells, in the height, and per s in the climb: an observer of about 6 rad/s."""
G = 9.80665
HEIGHT_KP, HEIGHT_KI, CLIMB_KP, CLIMB_KI = 2.0, 0.5, 25.0, 15.0
MOST_CLIMB_M_S = 1.1
MOST_PUSH = 32.767
LOOP_S = LOOP_PASSES * DT
SCALE, BASE_THRUST, LEAST_THRUST = 1000.0, 36000.0, 20000.0
RADIANS = math.pi / 180.0


@inner
def estimate_height(fw: Record, s: Record, index: int) -> None:
    """Height (m) and climb (m/s), one pass on. index: of the pass since the start."""
    roll, pitch = RADIANS * fw.angles[0], -RADIANS * fw.angles[1]
    upright = math.cos(roll) * math.cos(pitch)
    up = (
        -math.sin(pitch) * fw.accel[0]
        + math.sin(roll) * math.cos(pitch) * fw.accel[1]
        + upright * fw.accel[2]
    )
    fw.climb += G * (up - 1.0) * DT
    fw.height += fw.climb * DT
    if index % RANGE_PASSES == 0 and upright > 0.5:
        true = max(s.y[2], 0.0) / max(_upright(s), 0.5)
        fw.range_m = max(true + RANGE_NOISE_M * normal(s.rng, SENSOR_STREAM), 0.0)
        if fw.range_m < MOST_RANGE_M:
            told = fw.range_m * upright - fw.height
            fw.height += HEIGHT_SHARE * told
            fw.climb += CLIMB_SHARE * told


@inner
def hold_height(fw: Record, index: int) -> float:
    """16-bit thrust that brings the craft to the height that was asked for."""
    if fw.thrust <= 0.0:
        fw.height_integral = 0.0
        fw.climb_integral = 0.0
    elif index % LOOP_PASSES != 0:
        return float(fw.thrust)
    error = fw.setpoint_height - fw.height
    fw.height_integral += error * LOOP_S
    wanted = HEIGHT_KP * error + HEIGHT_KI * fw.height_integral
    return _climb(fw, min(max(wanted, -MOST_CLIMB_M_S), MOST_CLIMB_M_S) - fw.climb)


@inner
def hold_climb(fw: Record, climb_m_s: float, index: int) -> float:
    """16-bit thrust that brings the craft, which climbs with ``climb_m_s``, to the rate that was
    asked for: never so little that its motors stand. The firmware's estimate is not modelled."""
    if fw.thrust <= 0.0:
        fw.climb_integral = 0.0
    elif index % LOOP_PASSES != 0:
        return float(fw.thrust)
    return _climb(fw, fw.setpoint_climb - climb_m_s)


@inner
def _climb(fw: Record, slow: float) -> float:
    """slow: m/s below what is wanted."""
    fw.climb_integral += slow * LOOP_S
    push = min(max(CLIMB_KP * slow + CLIMB_KI * fw.climb_integral, -MOST_PUSH), MOST_PUSH)
    return min(max(BASE_THRUST + SCALE * push, LEAST_THRUST), FULL_16_BIT)


@inner
def _upright(s: Record) -> float:
    """Cosine of the angle between the craft's axis and the vertical."""
    a, b = s.y[7], s.y[8]
    return 1.0 - 2.0 * (a * a + b * b)
