"""Height and speed by today's firmware: what it makes of a Z-ranger, and the loops that hold them.

Loops and gains: ``position_controller_pid.c``, ``platform_defaults_cf2.h`` (2.0 and 0.5 on height,
25 and 15 on climb; 25 and 1 on the speed forward and to the left). The estimator stands for the
firmware's Kalman filter where there is a Z-ranger alone: acceleration, corrected by each range.
"""

from __future__ import annotations

import math

from firmware_sim.compiled import inner
from firmware_sim.flow_deck import MOST_RANGE_M, measure_range
from firmware_sim.layout import PASS_NS, Record
from groundstation.telemetry.packet import FULL_16_BIT

DT = PASS_NS * 1e-9
RANGE_PASSES, LOOP_PASSES = 13, 5
"""Between two ranges (the sensor's 26 ms) and two passes of the loops (100 Hz)."""
HEIGHT_SHARE, CLIMB_SHARE = 0.25, 1.2
"""Of what a range tells, in the height, and per s in the climb: an observer of about 6 rad/s."""
G = 9.80665
HEIGHT_KP, HEIGHT_KI, CLIMB_KP, CLIMB_KI = 2.0, 0.5, 25.0, 15.0
SPEED_KP, SPEED_KI = 25.0, 1.0
"""Degrees per m/s and per m."""
MOST_LEAN_DEG = 20.0
MOST_CLIMB_M_S = 1.1
MOST_PUSH = 32.767
LOOP_S = LOOP_PASSES * DT
SCALE = 1000.0
RADIANS = math.pi / 180.0


@inner
def estimate_height(p: Record, fw: Record, s: Record, index: int) -> None:
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
        measure_range(p, fw, s, False)
        if fw.range_m < MOST_RANGE_M:
            told = fw.range_m * upright - fw.height
            fw.height += HEIGHT_SHARE * told
            fw.climb += CLIMB_SHARE * told
    fw.place[2], fw.place[5] = fw.height, fw.climb
    fw.kalman_reset = 0  # it never lost its way
    if fw.knows_place != 0:  # a positioning system without fault
        for i in range(2):
            fw.place[i], fw.place[3 + i] = s.y[i], s.y[3 + i]


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
    return min(max(fw.base_thrust + SCALE * push, fw.least_thrust), FULL_16_BIT)


@inner
def hold_speed(fw: Record, index: int) -> None:
    """Leans for the velocity over ground that was asked for. The loops run beside other setpoints
    too, as if asked for 0, and go on from what they have summed up then."""
    if fw.thrust <= 0.0:
        fw.speed_integral[0] = fw.speed_integral[1] = 0.0
    elif index % LOOP_PASSES != 0:
        return
    cosine, sine = math.cos(RADIANS * fw.angles[2]), math.sin(RADIANS * fw.angles[2])
    forward = cosine * fw.place[3] + sine * fw.place[4]
    leftward = cosine * fw.place[4] - sine * fw.place[3]
    lean_forward = _lean(fw, 0, forward)
    lean_left = _lean(fw, 1, leftward)
    if fw.holds_speed != 0:
        fw.setpoint[0], fw.setpoint[1] = -lean_left, -lean_forward


@inner
def _lean(fw: Record, axis: int, speed: float) -> float:
    """Degrees towards the side of that axis."""
    error = (fw.setpoint_speed[axis] if fw.holds_speed != 0 else 0.0) - speed
    fw.speed_integral[axis] += error * LOOP_S
    lean = SPEED_KP * error + SPEED_KI * fw.speed_integral[axis]
    return min(max(lean, -MOST_LEAN_DEG), MOST_LEAN_DEG)


THRUST, CLIMB, HEIGHT, SPEED = 1, 2, 3, 4
"""Kinds of setpoints."""


@inner
def begin_anew(fw: Record) -> None:
    """Clear the loops when the kind of the setpoint has changed: the release of August 2026."""
    mode = THRUST
    if fw.holds_climb != 0:
        mode = CLIMB
    elif fw.holds_height != 0:
        mode = SPEED if fw.holds_speed != 0 else HEIGHT
    if mode == fw.mode:
        return
    fw.mode = mode
    fw.height_integral = fw.climb_integral = 0.0
    fw.speed_integral[0] = fw.speed_integral[1] = 0.0
    for axis in range(3):
        fw.rate_integral[axis] = fw.angle_integral[axis] = 0.0
        fw.rate_previous[axis] = 0.0
        fw.angle_previous[axis] = fw.angles[axis]
