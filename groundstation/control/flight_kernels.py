"""The firmware's cascade around the craft of ``simulate``, compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.compiled import kernel
from groundstation.control.firmware_kernels import (
    compensated,
    fused,
    rate_pid,
    rate_today,
    update,
    update_today,
    wrapped,
)
from groundstation.control.plant_kernels import STILL, body_on, move
from groundstation.dynamics import sensing as quaternion
from groundstation.dynamics.craft import SENSOR_STATES
from groundstation.dynamics.kernels import ALL, body_slope, physics
from groundstation.dynamics.sensing import (
    ROOM,
    SMOOTHING,
    UNSMOOTHED,
    begin,
    carried,
    estimated,
    follow,
    sense,
    smoothed,
)
from groundstation.telemetry.packet import FULL_16_BIT

DEGREES = 180.0 / math.pi
HALF_PERIOD_S = 0.002
"""Of 2014's angle PIDs, which run at 250 Hz and integrate as if at 500 Hz."""


@kernel
def cascade_run(
    craft: Any,
    sensor: Any,
    airframe_x: bool,
    fusion: bool,
    start: Any,
    f: Any,
    setpoints: Any,
    thrust: Any,
    supply_mv: Any,
    period: float,
    angles: Any,
    gyro: Any,
    compare: Any,
) -> None:
    """The firmware's loops on the craft, one row per pass of 2 ms.

    setpoints (k, 3): roll, pitch (nose down) in rad, yaw rate (counter-clockwise) in rad/s;
    thrust (k,) 16-bit; supply (k,) mV. Fills angles (k, 3) as the firmware estimates them (rad,
    nose down), gyro (k, 3) as it measures them (rad/s), compare (k, 4) PWM steps of 1/512.
    start: the state. fusion: the angles are the firmware's filter's, otherwise the true ones.
    ``f`` holds the firmware's state and is changed.
    """
    p, way, rows = physics(craft), carried(craft, period), len(setpoints)
    y, work, z = start.copy(), np.zeros((3, len(start))), np.zeros((ROOM, SENSOR_STATES))
    late = sensor.delay / period
    depth = int(late) + 2
    past = np.zeros((depth, 10))
    mount = (sensor.mount[0], sensor.mount[1], sensor.mount[2], sensor.mount[3])
    found, mixed, desired, duty = np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(4)
    n = (y[13], y[14], y[15], y[16])
    still = (0.0, 0.0, 0.0, 0.0)
    before = body_slope(p, n, still, STILL, y, work[0], ALL)
    begin(craft, before, z[0])
    felt, volts = before.force, still
    smoothing = SMOOTHING if f.today == 0 else UNSMOOTHED
    for k in range(rows):
        now = past[k % depth]
        if k > 0:
            after = body_on(p, volts, y, work[0])
            if craft.sensor_states > 0:
                follow(craft, way, before, after, period, z)
            before = after
        reading = sense(craft, before, z[0], z[1])
        felt = smoothed(felt, reading.accelerometer, period, smoothing)
        q = estimated(craft, (y[6], y[7], y[8], y[9]), z[0])
        now[0], now[1], now[2], now[3] = q
        for axis in range(3):
            now[4 + axis] = reading.gyro[axis] - sensor.zero[axis]
            now[7 + axis] = felt[axis]
        at = max(k - late, 0.0)
        first = min(int(at), k)
        part = at - first
        low, high = first % depth, min(first + 1, k) % depth
        for axis in range(3):
            value = past[low, 4 + axis]
            gyro[k, axis] = value + part * (past[high, 4 + axis] - value)
        if k % 2 == 0:
            if fusion:
                rate = (gyro[k, 0], gyro[k, 1], gyro[k, 2])
                q = fused(f, rate, (past[low, 7], past[low, 8], past[low, 9]))
            else:
                q = (past[low, 0], past[low, 1], past[low, 2], past[low, 3])
                q = quaternion.product(q, mount)
            found[0], found[1], found[2] = quaternion.angles(q)
        # the firmware's degrees, pitch nose up
        if f.today != 0:
            f.heading = wrapped(f.heading + DEGREES * setpoints[k, 2] * period)
            for axis in range(3):
                sign = -1.0 if axis == 1 else 1.0
                at_deg = sign * DEGREES * found[axis]
                goal = f.heading if axis == 2 else sign * DEGREES * setpoints[k, axis]
                desired[axis] = update_today(
                    f,
                    0,
                    axis,
                    wrapped(goal - at_deg),
                    at_deg,
                    f.angle_limit[axis],
                    f.angle_kp[axis],
                    f.angle_ki[axis],
                    f.angle_kd[axis],
                )
        elif k % 2 == 0:
            for axis in range(2):
                sign = 1.0 if axis == 0 else -1.0
                error = sign * DEGREES * (setpoints[k, axis] - found[axis])
                desired[axis] = update(
                    f,
                    0,
                    axis,
                    error,
                    HALF_PERIOD_S,
                    f.angle_limit[axis],
                    f.angle_kp[axis],
                    f.angle_ki[axis],
                    f.angle_kd[axis],
                )
            desired[2] = DEGREES * setpoints[k, 2]
        for axis in range(3):
            angles[k, axis] = found[axis]
        if f.today != 0:
            roll = rate_today(f, 0, desired[0], DEGREES * gyro[k, 0])
            pitch = rate_today(f, 1, desired[1], -DEGREES * gyro[k, 1])
            yaw = -rate_today(f, 2, desired[2], DEGREES * gyro[k, 2])
        else:
            roll = rate_pid(f, 0, desired[0] - DEGREES * gyro[k, 0])
            pitch = rate_pid(f, 1, desired[1] + DEGREES * gyro[k, 1])
            yaw = -rate_pid(f, 2, desired[2] - DEGREES * gyro[k, 2])
            if yaw > 32767.0:
                yaw = -32768.0  # the negative of -32768 in 16 bits
        if airframe_x:
            roll, pitch = 0.5 * roll, 0.5 * pitch
            mixed[0], mixed[1] = -roll + pitch + yaw, -roll - pitch - yaw
            mixed[2], mixed[3] = roll - pitch + yaw, roll + pitch - yaw
        else:
            mixed[0], mixed[1] = pitch + yaw, -roll - yaw
            mixed[2], mixed[3] = -pitch + yaw, roll - yaw
        beyond = 0.0
        if f.today != 0:
            for i in range(4):
                mixed[i] = compensated(f, thrust[k] + mixed[i], supply_mv[k] / 1000.0)
                beyond = max(beyond, mixed[i] - FULL_16_BIT)
        for i in range(4):
            # today's lowers all motors together: attitude comes before thrust
            wanted = mixed[i] - beyond if f.today != 0 else thrust[k] + mixed[i]
            steps = min(max(wanted, 0.0), FULL_16_BIT) / 128.0
            compare[k, i] = steps
            duty[i] = steps / 512.0
        driven = (duty[0], duty[1], duty[2], duty[3])
        volts = move(p, driven, supply_mv, k, period, y, work)


@kernel
def cascade_many(
    craft: Any,
    sensor: Any,
    airframe_x: bool,
    fusion: bool,
    start: Any,
    rest: Any,
    f: Any,
    axis: int,
    gains: Any,
    base: Any,
    hold: Any,
    lean: Any,
    integral: Any,
    derivative: Any,
    sharp: Any,
    push: Any,
    late: Any,
    fast: float,
    slow: float,
    worst_peak: float,
    size: float,
    thrust: Any,
    level: Any,
    supply_mv: Any,
    period: float,
    peak: Any,
    effort: Any,
    compliance: Any,
    y: Any,
) -> None:
    """Judge gains (m, 6), rate kp and ki, angle kp, ki and kd, rate kd, of one axis by a step of
    ``size``; level (k,): the steps of 1/512 of full PWM that hold the hover.

    The loop at n frequencies is base ((rate) (hold + (angle) lean) + rate derivative hold), with
    the responses of an integral, of the derivatives of angle and rate, and of the craft to a push;
    fast and slow the firmware's factors on integrals, late the phase of more delay. Fills
    peak (m,), the maximum sensitivity, inf where the loop is unstable or worse than
    ``worst_peak``; effort (m,), the largest step of a motor, 0..1; compliance (m,), how far
    a push of 1 rad/s^2 moves it at worst; y (m, k), the response over
    ``size``. ``rest`` is the firmware at rest, ``f`` room for its state.
    """
    rows = y.shape[1]
    setpoints = np.zeros((rows, 3))
    setpoints[:, axis] = size
    angles, gyro, compare = np.zeros((rows, 3)), np.zeros((rows, 3)), np.zeros((rows, 4))
    for m in range(len(gains)):
        effort[m], yields = math.inf, 0.0
        least, phase, delayed, lost = math.inf, 0.0, 0.0, False
        reach, reach_late = 0.0, 0.0
        for i in range(len(base)):
            rate = gains[m, 0] + fast * gains[m, 1] * integral[i]
            angle = gains[m, 2] + slow * gains[m, 3] * integral[i]
            angle += gains[m, 4] / slow * derivative[i]
            loop = base[i] * (rate * (hold[i] + angle * lean[i]) + gains[m, 5] * sharp[i] * hold[i])
            away = 1.0 + loop
            distance = away.real * away.real + away.imag * away.imag
            least = min(least, distance)
            yields = max(yields, push[i] * push[i] / distance)
            turned = math.atan2(loop.imag, loop.real)
            delay_phase = turned + late[i]
            if i == 0:
                # the phases of base and gains, not wrapped: integrals count
                expected = math.atan2(base[0].imag, base[0].real) + math.atan2(rate.imag, rate.real)
                around = hold[i] + angle * lean[i]
                expected += math.atan2(around.imag, around.real)
                turned += 2.0 * math.pi * np.round((expected - turned) / (2.0 * math.pi))
                phase, delayed = turned, turned + late[0]
                reach, reach_late = phase, delayed  # a loop weaker than 1 here crossed it before
            else:
                phase += (turned - phase + math.pi) % (2.0 * math.pi) - math.pi
                delayed += (delay_phase - delayed + math.pi) % (2.0 * math.pi) - math.pi
            if loop.real * loop.real + loop.imag * loop.imag > 1.0:
                reach, reach_late = phase, delayed
                lost = i == len(base) - 1
        peak[m], compliance[m] = 1.0 / math.sqrt(least), math.sqrt(yields)
        stable = reach > -math.pi and reach_late > -math.pi
        if lost or not stable or peak[m] > worst_peak:
            peak[m] = math.inf
            continue
        for kind in range(2):
            for i in range(3):
                f.integral[kind, i] = 0.0
                f.previous[kind, i] = 0.0
        for i in range(3):
            f.quaternion[i + 1] = 0.0
            f.feedback[i] = 0.0
            f.rate_kp[i], f.rate_ki[i] = rest.rate_kp[i], rest.rate_ki[i]
            f.angle_kp[i], f.angle_ki[i] = rest.angle_kp[i], rest.angle_ki[i]
            f.rate_kd[i], f.angle_kd[i] = rest.rate_kd[i], rest.angle_kd[i]
        f.quaternion[0], f.heading = 1.0, 0.0
        f.rate_kp[axis], f.rate_ki[axis], f.rate_kd[axis] = gains[m, 0], gains[m, 1], gains[m, 5]
        f.angle_kp[axis], f.angle_ki[axis] = gains[m, 2], gains[m, 3]
        f.angle_kd[axis] = gains[m, 4]
        cascade_run(
            craft,
            sensor,
            airframe_x,
            fusion,
            start,
            f,
            setpoints,
            thrust,
            supply_mv,
            period,
            angles,
            gyro,
            compare,
        )
        largest = 0.0
        for k in range(rows):
            y[m, k] = (gyro[k, axis] if axis == 2 else angles[k, axis]) / size
            for i in range(4):
                largest = max(largest, abs(compare[k, i] - level[k]))
        effort[m] = largest / 512.0
