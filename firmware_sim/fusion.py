"""Gyro bias at start-up and the Mahony filter, as release 2014.01.0 runs them at 250 Hz."""

from __future__ import annotations

import math

from firmware_sim.compiled import inner
from firmware_sim.layout import CALIBRATION_SAMPLES, Record

COUNTS_PER_DPS = 16.384
COUNTS_PER_G = 4096.0
FUSION_DT = 0.004
VARIANCE_LIMIT = 4000.0
DEGREES = 180.0 / math.pi


@inner
def calibrate(fw: Record, x: int, y: int, z: int) -> None:
    """One gyro sample into the bias search: found once all three axes have been quiet.

    A ring of 128 samples; quiet is a sum of squared deviations below 4000 on each axis.
    """
    slot = fw.bias_seen % CALIBRATION_SAMPLES
    fw.bias_ring[slot, 0] = x
    fw.bias_ring[slot, 1] = y
    fw.bias_ring[slot, 2] = z
    fw.bias_seen += 1
    if fw.bias_seen < CALIBRATION_SAMPLES:
        return
    for axis in range(3):
        total = 0
        squares = 0
        for i in range(CALIBRATION_SAMPLES):
            value = fw.bias_ring[i, axis]
            total += value
            squares += value * value
        if squares - total * total / CALIBRATION_SAMPLES >= VARIANCE_LIMIT:
            return
        fw.bias[axis] = int(total / CALIBRATION_SAMPLES)
    fw.bias_found = 1


@inner
def smooth_acceleration(fw: Record) -> None:
    """The 10 Hz filter that only the fusion sees."""
    gain = fw.accel_factor / 256.0
    for i in range(3):
        fw.accel_smooth[i] += gain * (fw.accel[i] - fw.accel_smooth[i])


@inner
def fuse(fw: Record) -> None:
    """One Mahony update with the current gyro sample; leaves ``fw.angles`` in degrees."""
    gx, gy, gz = fw.gyro[0] / DEGREES, fw.gyro[1] / DEGREES, fw.gyro[2] / DEGREES
    ax, ay, az = fw.accel_smooth[0], fw.accel_smooth[1], fw.accel_smooth[2]
    q0, q1, q2, q3 = fw.quaternion[0], fw.quaternion[1], fw.quaternion[2], fw.quaternion[3]
    length = math.sqrt(ax * ax + ay * ay + az * az)
    if length > 0.0:
        ax, ay, az = ax / length, ay / length, az / length
        vx, vy = q1 * q3 - q0 * q2, q0 * q1 + q2 * q3
        vz = q0 * q0 - 0.5 + q3 * q3
        ex, ey, ez = ay * vz - az * vy, az * vx - ax * vz, ax * vy - ay * vx
        if fw.fusion_ki > 0.0:
            fw.feedback[0] += fw.fusion_ki * ex * FUSION_DT
            fw.feedback[1] += fw.fusion_ki * ey * FUSION_DT
            fw.feedback[2] += fw.fusion_ki * ez * FUSION_DT
            gx, gy, gz = gx + fw.feedback[0], gy + fw.feedback[1], gz + fw.feedback[2]
        else:
            fw.feedback[0] = 0.0
            fw.feedback[1] = 0.0
            fw.feedback[2] = 0.0
        gx, gy, gz = gx + fw.fusion_kp * ex, gy + fw.fusion_kp * ey, gz + fw.fusion_kp * ez
    h = 0.5 * FUSION_DT
    n0 = q0 + h * (-q1 * gx - q2 * gy - q3 * gz)
    n1 = q1 + h * (q0 * gx + q2 * gz - q3 * gy)
    n2 = q2 + h * (q0 * gy - q1 * gz + q3 * gx)
    n3 = q3 + h * (q0 * gz + q1 * gy - q2 * gx)
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2 + n3 * n3)
    q0, q1, q2, q3 = n0 / length, n1 / length, n2 / length, n3 / length
    fw.quaternion[0] = q0
    fw.quaternion[1] = q1
    fw.quaternion[2] = q2
    fw.quaternion[3] = q3
    up_x = 2.0 * (q1 * q3 - q0 * q2)
    fw.angles[0] = DEGREES * math.atan2(
        2.0 * (q0 * q1 + q2 * q3), q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3
    )
    fw.angles[1] = DEGREES * math.asin(min(max(up_x, -1.0), 1.0))
    fw.angles[2] = DEGREES * math.atan2(
        2.0 * (q0 * q3 + q1 * q2), q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3
    )
