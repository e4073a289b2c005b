"""The MPU6050: what the sensor feels, filters, samples on its own clock and puts in registers.

Its digital low-pass is a first-order lag with the data sheet's bandwidth; what the data sheet's
delay has beyond that lag is pure delay (see ``DLPF``). The sample clock is not the loop's: a
sample waits 0..2 ms until the loop fetches it.
"""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.imu_lever_arm import lever_arm_acceleration
from firmware_sim.effects.own import lawful_reading
from firmware_sim.effects.position_aided_lean import tilt_taken
from firmware_sim.layout import (
    ACCEL_DLPF,
    GYRO_DLPF,
    GYRO_LAG,
    PHASE,
    RATE,
    ROTOR,
    SENSOR_RING,
    SENSOR_STREAM,
    Record,
)
from firmware_sim.random_numbers import normal

GYRO_COUNTS = 16.384 * 180.0 / math.pi
"""Counts per rad/s."""
ACCEL_COUNTS = 4096.0 / 9.80665
"""Counts per m/s^2."""
DEGREES = 180.0 / math.pi

IMBALANCE = (1.0, 0.7, 1.2, 0.9)
"""How badly each propeller is balanced, relative to the craft's ``shake``."""
SHAKE_REV_S = 250.0
YAW_SHAKE = 0.3
"""The yaw gyro shakes less than the others."""


@inner
def filter_slopes(p: Record, s: Record, y: Any, dy: Any) -> None:
    """Slopes of the gyro's and the accelerometer's lags, with the rotors' imbalance in them."""
    shaken, twisted = vibration(p, y)
    felt_x = s.force[0] + shaken[0]
    felt_y = s.force[1] + shaken[1]
    felt_z = s.force[2] + shaken[2]
    if p.levered != 0:
        lever_x, lever_y, lever_z = lever_arm_acceleration(p, y, dy)
        felt_x += lever_x
        felt_y += lever_y
        felt_z += lever_z
    rate_x = y[RATE] + twisted[0]
    rate_y = y[RATE + 1] + twisted[1]
    rate_z = y[RATE + 2] + twisted[2]
    if p.lawful != 0:
        force = (s.force[0], s.force[1], s.force[2])
        rate, felt = lawful_reading(
            p, y, dy, force, (rate_x, rate_y, rate_z), (felt_x, felt_y, felt_z)
        )
        rate_x, rate_y, rate_z = rate
        felt_x, felt_y, felt_z = felt
    if p.gyro_lag > 0.0:
        dy[GYRO_LAG] = (rate_x - y[GYRO_LAG]) / p.gyro_lag
        dy[GYRO_LAG + 1] = (rate_y - y[GYRO_LAG + 1]) / p.gyro_lag
        dy[GYRO_LAG + 2] = (rate_z - y[GYRO_LAG + 2]) / p.gyro_lag
        rate_x, rate_y, rate_z = y[GYRO_LAG], y[GYRO_LAG + 1], y[GYRO_LAG + 2]
    if p.dlpf_s[0] > 0.0:
        dy[GYRO_DLPF] = (rate_x - y[GYRO_DLPF]) / p.dlpf_s[0]
        dy[GYRO_DLPF + 1] = (rate_y - y[GYRO_DLPF + 1]) / p.dlpf_s[0]
        dy[GYRO_DLPF + 2] = (rate_z - y[GYRO_DLPF + 2]) / p.dlpf_s[0]
        dy[ACCEL_DLPF] = (felt_x - y[ACCEL_DLPF]) / p.dlpf_s[1]
        dy[ACCEL_DLPF + 1] = (felt_y - y[ACCEL_DLPF + 1]) / p.dlpf_s[1]
        dy[ACCEL_DLPF + 2] = (felt_z - y[ACCEL_DLPF + 2]) / p.dlpf_s[1]


@inner
def vibration(p: Record, y: Any) -> Any:
    """What the rotors' imbalance adds to specific force (m/s^2) and rates (rad/s)."""
    in_plane_x, in_plane_y, axial = 0.0, 0.0, 0.0
    twist_x, twist_y, twist_z = 0.0, 0.0, 0.0
    if p.shake[0] != 0.0 or p.shake[1] != 0.0 or p.shake[2] != 0.0:
        for i in range(4):
            ratio = y[ROTOR + i] / SHAKE_REV_S
            size = IMBALANCE[i] * ratio * ratio
            angle = 2.0 * math.pi * y[PHASE + i]
            cosine, sine = size * math.cos(angle), size * math.sin(angle)
            in_plane_x += cosine
            in_plane_y += p.spin[i] * sine
            axial += cosine * p.rotor_y[i] + sine * p.rotor_x[i]
            twist_x += sine
            twist_y += cosine
            twist_z += p.spin[i] * cosine
    reach = math.sqrt(p.rotor_x[0] * p.rotor_x[0] + p.rotor_y[0] * p.rotor_y[0])
    axial *= p.shake[1] / reach
    return (
        (p.shake[0] * in_plane_x, p.shake[0] * in_plane_y, axial),
        (p.shake[2] * twist_x, p.shake[2] * twist_y, YAW_SHAKE * p.shake[2] * twist_z),
    )


@inner
def sample(p: Record, s: Record, time_ns: int) -> None:
    """Take one sample of the state ``s.y`` into the ring; its slopes are in ``s.slope``."""
    y = s.y
    slot = s.sampled % SENSOR_RING
    if p.dlpf_s[0] > 0.0:
        rx, ry, rz = y[GYRO_DLPF], y[GYRO_DLPF + 1], y[GYRO_DLPF + 2]
        fx, fy, fz = y[ACCEL_DLPF], y[ACCEL_DLPF + 1], y[ACCEL_DLPF + 2]
    else:
        shaken, twisted = vibration(p, y)
        rx, ry, rz = y[RATE] + twisted[0], y[RATE + 1] + twisted[1], y[RATE + 2] + twisted[2]
        if p.gyro_lag > 0.0:
            rx, ry, rz = y[GYRO_LAG], y[GYRO_LAG + 1], y[GYRO_LAG + 2]
        fx, fy, fz = s.force[0] + shaken[0], s.force[1] + shaken[1], s.force[2] + shaken[2]
        if p.levered != 0:
            lever_x, lever_y, lever_z = lever_arm_acceleration(p, y, s.slope)
            fx += lever_x
            fy += lever_y
            fz += lever_z
        if p.lawful != 0:
            force = (s.force[0], s.force[1], s.force[2])
            rate, felt = lawful_reading(p, y, s.slope, force, (rx, ry, rz), (fx, fy, fz))
            rx, ry, rz = rate
            fx, fy, fz = felt
    w, a, b, c = y[6], y[7], y[8], y[9]
    if p.rotated != 0:
        m = p.mounting
        rx, ry, rz = _into_sensor(m, rx, ry, rz)
        fx, fy, fz = _into_sensor(m, fx, fy, fz)
    warm = 1.0
    if p.warm_up > 0.0:
        warm = 1.0 - math.exp(-(time_ns - s.boot_ns) * 1e-9 / p.warm_up)
    rates = (rx, ry, rz)
    forces = (fx, fy, fz)
    for i in range(3):
        rate = rates[i] + p.gyro_offset[i] + warm * p.gyro_drift[i]
        rate += p.gyro_noise * normal(s.rng, SENSOR_STREAM)
        sensed = forces[i] + p.accel_bias[i] + p.accel_noise * normal(s.rng, SENSOR_STREAM)
        if p.filtered != 0:
            rate = _low_pass(p.gyro_filter, s.filter, i, rate)
            sensed = _low_pass(p.accel_filter, s.filter, 3 + i, sensed)
        s.ring_gyro[slot, i] = register(rate * GYRO_COUNTS)
        s.ring_accel[slot, i] = register(sensed * ACCEL_COUNTS)
    if p.ideal_attitude != 0:
        if p.filtered != 0:
            w, a, b, c = _estimated(p, s, w, a, b, c)
        _sample_attitude(p, s, slot, w, a, b, c)
    s.sampled_ns[slot] = time_ns
    s.ring_ready_ns[slot] = time_ns + p.pipeline_ns
    s.sampled += 1


@inner
def _low_pass(coefficients: Any, memory: Any, channel: int, value: float) -> float:
    """One step of a second-order filter in direct form 2."""
    inside = value - coefficients[3] * memory[channel, 0] - coefficients[4] * memory[channel, 1]
    out = (
        coefficients[0] * inside
        + coefficients[1] * memory[channel, 0]
        + coefficients[2] * memory[channel, 1]
    )
    memory[channel, 1] = memory[channel, 0]
    memory[channel, 0] = inside
    return float(out)


@inner
def _estimated(p: Record, s: Record, w: float, a: float, b: float, c: float) -> Any:
    """The attitude of an estimator without fault: it turns by the gyro behind the firmware's
    filter, so it is as late as that. (w, a, b, c) is the true one."""
    w = _low_pass(p.gyro_filter, s.filter, 6, w)
    a = _low_pass(p.gyro_filter, s.filter, 7, a)
    b = _low_pass(p.gyro_filter, s.filter, 8, b)
    c = _low_pass(p.gyro_filter, s.filter, 9, c)
    scale = 1.0 / math.sqrt(w * w + a * a + b * b + c * c)
    return w * scale, a * scale, b * scale, c * scale


@inner
def register(counts: float) -> int:
    """A 16-bit register: rounded and saturated."""
    return int(min(max(math.floor(counts + 0.5), -32768.0), 32767.0))


@inner
def fetch(s: Record, now_ns: int) -> int:
    """Slot of the newest sample that has reached the loop by ``now_ns``."""
    while s.read + 1 < s.sampled and s.ring_ready_ns[(s.read + 1) % SENSOR_RING] <= now_ns:
        s.read += 1
    return s.read % SENSOR_RING


@inner
def _into_sensor(m: Any, x: float, y: float, z: float) -> Any:
    return (
        m[0] * x + m[3] * y + m[6] * z,
        m[1] * x + m[4] * y + m[7] * z,
        m[2] * x + m[5] * y + m[8] * z,
    )


@inner
def _sample_attitude(
    p: Record, s: Record, slot: int, w: float, a: float, b: float, c: float
) -> None:
    """Euler angles of the sensor (eq. 3.6), true but for what an estimator takes for a tilt, plus
    white noise, deg, firmware convention."""
    r11, r21 = 1 - 2 * (b * b + c * c), 2 * (a * b + w * c)
    r31, r32, r33 = 2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)
    if p.rotated != 0:
        m = p.mounting
        r12, r13 = 2 * (a * b - w * c), 2 * (a * c + w * b)
        r22, r23 = 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)
        r11, r21 = r11 * m[0] + r12 * m[3] + r13 * m[6], r21 * m[0] + r22 * m[3] + r23 * m[6]
        r31, r32, r33 = _into_sensor(m, r31, r32, r33)
    roll = math.atan2(r32, r33)
    pitch = math.asin(min(max(r31, -1.0), 1.0))  # nose up positive
    if p.aided_strength > 0.0:
        ahead, aside, up = s.force[0], s.force[1], s.force[2]
        if p.rotated != 0:
            ahead, aside, up = _into_sensor(p.mounting, ahead, aside, up)
        forward, left = tilt_taken(p, s, ahead, aside, 1e-9 * p.sensor_period_ns)
        roll -= left
        pitch -= forward
    yaw = math.atan2(r21, r11)
    scale = p.angle_noise
    s.ring_angles[slot, 0] = (roll + scale * normal(s.rng, SENSOR_STREAM)) * DEGREES
    s.ring_angles[slot, 1] = (pitch + scale * normal(s.rng, SENSOR_STREAM)) * DEGREES
    s.ring_angles[slot, 2] = (yaw + scale * normal(s.rng, SENSOR_STREAM)) * DEGREES
