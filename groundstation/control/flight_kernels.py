"""Compiled closed loops with motors: the thesis's Figure 8.10, and the firmware's cascade.

One file, because the compiler's cache looks at the entry point's own file only. The body's state
is quaternion 0-3 (body to inertial), rates 4-6 in rad/s, rotors 7-10 in rev/s.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

DEGREES = 180.0 / math.pi
STATES = 11
RATE, ROTOR = 4, 7
PWM_FULL = 4096.0


@njit(nogil=True, error_model="numpy", inline="always")
def _slope(p: Any, volts: Any, y: Any, dy: Any) -> None:
    """Motors (eq. 3.82), mixer (7.19), rotation (3.49-3.53, 3.18) and the effects of ``plant``."""
    roll, pitch, yaw, lift, spin, gain = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    sign = 1.0  # M1 and M3 counter-clockwise
    for i in range(4):
        n = y[ROTOR + i]
        slope = p.a0 * max(volts[i] - p.dead_mv, 0.0) - (p.a1 + p.a2 * n) * n
        if slope < 0.0:
            slope *= p.braking
        dy[ROTOR + i] = slope
        square = p.strength[i] * n * n
        roll += p.mix[0, i] * square
        pitch += p.mix[1, i] * square
        yaw += p.mix[2, i] * square
        lift += square
        spin -= sign * n
        gain -= sign * slope
        sign = -sign
    w, a, b, c = y[0], y[1], y[2], y[3]
    rp, rq, rr = y[4], y[5], y[6]
    dy[0] = 0.5 * (-a * rp - b * rq - c * rr)
    dy[1] = 0.5 * (w * rp + b * rr - c * rq)
    dy[2] = 0.5 * (w * rq + c * rp - a * rr)
    dy[3] = 0.5 * (w * rr + a * rq - b * rp)
    dy[4] = p.c[0] * roll + p.coupling[0] * rq * rr + p.gyroscopic[0] * rq * spin
    dy[5] = p.c[1] * pitch + p.coupling[1] * rp * rr - p.gyroscopic[1] * rp * spin
    dy[6] = p.c[2] * yaw + p.coupling[2] * rp * rq + p.spin_up * gain - p.damping[2] * rr
    dy[4] += p.offset[0] * lift - (p.damping[0] + p.quadratic[0] * abs(rp)) * rp
    dy[5] += p.offset[1] * lift - (p.damping[1] + p.quadratic[1] * abs(rq)) * rq


@njit(nogil=True, error_model="numpy")
def _step(p: Any, volts: Any, h: float, y: Any, work: Any) -> None:
    """One Runge-Kutta step (order 4) with inputs held."""
    start, slope, total = work[0], work[1], work[2]
    for i in range(STATES):
        start[i] = y[i]
    _slope(p, volts, y, total)
    for i in range(STATES):
        y[i] = start[i] + 0.5 * h * total[i]
    _slope(p, volts, y, slope)
    for i in range(STATES):
        total[i] += 2.0 * slope[i]
        y[i] = start[i] + 0.5 * h * slope[i]
    _slope(p, volts, y, slope)
    for i in range(STATES):
        total[i] += 2.0 * slope[i]
        y[i] = start[i] + h * slope[i]
    _slope(p, volts, y, slope)
    for i in range(STATES):
        y[i] = start[i] + h / 6.0 * (total[i] + slope[i])


@njit(nogil=True, error_model="numpy")
def _euler(w: float, a: float, b: float, c: float, out: Any) -> None:
    """Roll, pitch (nose down positive), yaw in rad of a quaternion (eq. 3.6)."""
    out[0] = math.atan2(2.0 * (w * a + b * c), 1.0 - 2.0 * (a * a + b * b))
    out[1] = math.asin(min(max(2.0 * (w * b - a * c), -1.0), 1.0))
    out[2] = math.atan2(2.0 * (w * c + a * b), 1.0 - 2.0 * (b * b + c * c))


@njit(nogil=True, cache=True, error_model="numpy")
def whole_run(
    p: Any,
    arx_a: Any,
    arx_b: Any,
    arx_nk: Any,
    body: int,
    gains: Any,
    limit: float,
    conditional: bool,
    thrust: Any,
    supply_mv: Any,
    reference: Any,
    period: float,
    start_rev_s: float,
    delay: int,
    angles: Any,
    controls: Any,
    pwm: Any,
) -> None:
    """The whole simulation of thesis Figure 8.10, as long as ``reference`` (k, 3) in rad.

    body: 0 ARX (arx_a (3, na), arx_b (3, nb), arx_nk (3,), the delays inside), 1 grey box
    (decoupled accelerations, thesis 3.58-3.60), 2 rigid body. delay: samples from angle to
    controller, for bodies 1 and 2. gains (3, 3): kp, ki, kd per axis in PWM counts; thrust (k,)
    counts, supply (k,) mV. Fills angles (k, 3) as the controller hears them, controls (k, 3) and
    pwm (k, 4) in counts.
    """
    rows = len(reference)
    y, work = np.zeros(STATES), np.zeros((3, STATES))
    y[0] = 1.0
    y[ROTOR : ROTOR + 4] = start_rev_s
    grey = np.zeros(3)
    torque = np.zeros((rows, 3))
    true = np.zeros((rows, 3))
    integral, before, volts = np.zeros(3), np.zeros(3), np.zeros(4)
    na, nb = arx_a.shape[1], arx_b.shape[1]
    for k in range(rows):
        if body == 0:
            for axis in range(3):
                value = 0.0
                for i in range(min(na, k)):
                    value -= arx_a[axis, i] * angles[k - 1 - i, axis]
                for i in range(nb):
                    at = k - arx_nk[axis] - i
                    if at >= 0 and at < k:
                        value += arx_b[axis, i] * torque[at, axis]
                angles[k, axis] = value
        else:
            if body == 1:
                for axis in range(3):
                    true[k, axis] = grey[axis]
            else:
                _euler(y[0], y[1], y[2], y[3], true[k])
            for axis in range(3):
                angles[k, axis] = true[k - delay, axis] if k >= delay else 0.0
        for axis in range(3):
            error = reference[k, axis] - angles[k, axis]
            wanted = gains[axis, 0] * error + gains[axis, 1] * integral[axis]
            wanted += gains[axis, 2] * (error - before[axis]) / period
            given = min(max(wanted, -limit), limit)
            if not (conditional and wanted != given and gains[axis, 1] * error * wanted > 0.0):
                integral[axis] += period * error
            before[axis] = error
            controls[k, axis] = given
        for i in range(4):
            shared = p.mix[0, i] * controls[k, 0] + p.mix[1, i] * controls[k, 1]
            if p.airframe_x != 0:
                shared *= 0.5
            counts = thrust[k] + shared + p.mix[2, i] * controls[k, 2]
            pwm[k, i] = min(max(counts, 0.0), PWM_FULL)
            volts[i] = pwm[k, i] / PWM_FULL * supply_mv[k]
        for axis in range(3):
            for i in range(4):
                square = y[ROTOR + i] * y[ROTOR + i] * p.strength[i]
                torque[k, axis] += p.mix[axis, i] * square
        _step(p, volts, period, y, work)
        if body == 1:
            for axis in range(3):
                grey[axis] += 0.5 * period * (work[0, RATE + axis] + y[RATE + axis])


@njit(nogil=True, error_model="numpy")
def _update(
    f: Any, kind: int, axis: int, error: float, dt: float, limit: float, kp: float, ki: float,
    kd: float,
) -> float:  # fmt: skip
    """One PID of the firmware: its integral is clamped, its output is not."""
    lower = -5000.0 if f.quirk_lower_limit != 0 else -limit
    value = min(max(f.integral[kind, axis] + error * dt, lower), limit)
    f.integral[kind, axis] = value
    output = kp * error + ki * value + kd * (error - f.previous[kind, axis]) / dt
    f.previous[kind, axis] = error
    return float(output)


@njit(nogil=True, error_model="numpy")
def _rate_pid(f: Any, axis: int, error: float) -> float:
    """A rate PID as the clamp macro evaluates it: up to three times, truncated to 16 bits."""
    output = 0.0
    evaluations = 3 if f.quirk_clamp_macro != 0 else 1
    for evaluation in range(evaluations):
        output = _update(
            f, 1, axis, error, 0.002, f.rate_limit[axis],
            f.rate_kp[axis], f.rate_ki[axis], f.rate_kd[axis],
        )  # fmt: skip
        if evaluation == 0 and output < -32768.0:
            break
        if (evaluation == 1 or evaluations == 1) and output > 32767.0:
            break
    output = min(max(output, -32768.0), 32767.0)
    return float(int(output)) if f.quantised != 0 else output


@njit(nogil=True, error_model="numpy")
def _fuse(f: Any, gx: float, gy: float, gz: float, out: Any) -> None:
    """The firmware's Mahony update at 250 Hz; the accelerometer feels thrust, along body z."""
    q0, q1, q2, q3 = f.quaternion[0], f.quaternion[1], f.quaternion[2], f.quaternion[3]
    ex, ey = -(q0 * q1 + q2 * q3), q1 * q3 - q0 * q2
    if f.fusion_ki > 0.0:
        f.feedback[0] += f.fusion_ki * ex * 0.004
        f.feedback[1] += f.fusion_ki * ey * 0.004
    gx += f.feedback[0] + f.fusion_kp * ex
    gy += f.feedback[1] + f.fusion_kp * ey
    n0 = q0 + 0.002 * (-q1 * gx - q2 * gy - q3 * gz)
    n1 = q1 + 0.002 * (q0 * gx + q2 * gz - q3 * gy)
    n2 = q2 + 0.002 * (q0 * gy - q1 * gz + q3 * gx)
    n3 = q3 + 0.002 * (q0 * gz + q1 * gy - q2 * gx)
    size = 1.0 / math.sqrt(n0 * n0 + n1 * n1 + n2 * n2 + n3 * n3)
    f.quaternion[0], f.quaternion[1] = n0 * size, n1 * size
    f.quaternion[2], f.quaternion[3] = n2 * size, n3 * size
    _euler(f.quaternion[0], f.quaternion[1], f.quaternion[2], f.quaternion[3], out)


@njit(nogil=True, cache=True, error_model="numpy")
def cascade_run(
    p: Any,
    f: Any,
    setpoints: Any,
    thrust: Any,
    supply_mv: Any,
    period: float,
    start_rev_s: float,
    angles: Any,
    gyro: Any,
    compare: Any,
) -> None:
    """The firmware's loops on the craft, one row per pass of 2 ms.

    setpoints (k, 3): roll, pitch (nose down) in rad, yaw rate (counter-clockwise) in rad/s;
    thrust (k,) 16-bit; supply (k,) mV. Fills angles (k, 3) as the firmware estimates them (rad,
    nose down), gyro (k, 3) as it measures them (rad/s), compare (k, 4) PWM steps of 512.
    ``f`` holds the firmware's state and is changed.
    """
    rows = len(setpoints)
    y, work = np.zeros(STATES), np.zeros((3, STATES))
    y[0] = 1.0
    y[ROTOR : ROTOR + 4] = start_rev_s
    late = p.delay_s / period
    depth = int(late) + 2
    past = np.zeros((depth, 7))
    lagged, volts, found = np.zeros(3), np.zeros(4), np.zeros(3)
    mixed, desired = np.zeros(4), np.zeros(3)
    share = math.exp(-period / p.lag_s) if p.lag_s > 0.0 else 0.0
    angle_dt = 0.002 if f.quirk_attitude_dt != 0 else 0.004
    for k in range(rows):
        now = past[k % depth]
        for i in range(4):
            now[i] = y[i]
        for axis in range(3):
            lagged[axis] = share * lagged[axis] + (1.0 - share) * y[RATE + axis]
            now[4 + axis] = lagged[axis]
        at = max(k - late, 0.0)
        first = min(int(at), k)
        part = at - first
        low, high = first % depth, min(first + 1, k) % depth
        for axis in range(3):
            value = past[low, 4 + axis]
            gyro[k, axis] = value + part * (past[high, 4 + axis] - value)
        if k % 2 == 0:
            if p.fusion != 0:
                _fuse(f, gyro[k, 0], gyro[k, 1], gyro[k, 2], found)
            else:
                _euler(past[low, 0], past[low, 1], past[low, 2], past[low, 3], found)
            # the firmware's degrees, pitch nose up
            for axis in range(2):
                sign = 1.0 if axis == 0 else -1.0
                error = sign * DEGREES * (setpoints[k, axis] - found[axis])
                desired[axis] = _update(
                    f, 0, axis, error, angle_dt, f.angle_limit[axis],
                    f.angle_kp[axis], f.angle_ki[axis], f.angle_kd[axis],
                )  # fmt: skip
            desired[2] = DEGREES * setpoints[k, 2]
        for axis in range(3):
            angles[k, axis] = found[axis]
        roll = _rate_pid(f, 0, desired[0] - DEGREES * gyro[k, 0])
        pitch = _rate_pid(f, 1, desired[1] + DEGREES * gyro[k, 1])
        yaw = -_rate_pid(f, 2, desired[2] - DEGREES * gyro[k, 2])
        if yaw > 32767.0:
            yaw = -32768.0 if f.quirk_negate != 0 else 32767.0
        if p.airframe_x != 0:
            roll, pitch = 0.5 * roll, 0.5 * pitch
            if f.quantised != 0:
                roll, pitch = math.floor(roll), math.floor(pitch)
            mixed[0], mixed[1] = -roll + pitch + yaw, -roll - pitch - yaw
            mixed[2], mixed[3] = roll - pitch + yaw, roll + pitch - yaw
        else:
            mixed[0], mixed[1] = pitch + yaw, -roll - yaw
            mixed[2], mixed[3] = -pitch + yaw, roll - yaw
        for i in range(4):
            steps = min(max(thrust[k] + mixed[i], 0.0), 65535.0) / 128.0
            if f.quantised != 0:
                steps = float(int(steps))
            compare[k, i] = steps
            volts[i] = steps / 512.0 * supply_mv[k]
        _step(p, volts, period, y, work)
        size = 1.0 / math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2] + y[3] * y[3])
        for i in range(4):
            y[i] *= size


@njit(nogil=True, cache=True, error_model="numpy")
def cascade_many(
    p: Any,
    rest: Any,
    f: Any,
    axis: int,
    gains: Any,
    base: Any,
    hold: Any,
    lean: Any,
    integral: Any,
    derivative: Any,
    push: Any,
    late: Any,
    fast: float,
    slow: float,
    worst_peak: float,
    size: float,
    thrust: Any,
    supply_mv: Any,
    period: float,
    start_rev_s: float,
    peak: Any,
    effort: Any,
    compliance: Any,
    y: Any,
) -> None:
    """Judge gains (m, 5), rate kp and ki, angle kp, ki and kd, of one axis by a step of ``size``.

    The loop at n frequencies is base (rate) (hold + (angle) lean), with the responses of
    an integral, of the angle's derivative, and of the craft to a push; fast and slow the firmware's
    factors on integrals, late the phase of more delay. Fills
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
        reach, reach_late = -math.inf, -math.inf
        for i in range(len(base)):
            rate = gains[m, 0] + fast * gains[m, 1] * integral[i]
            angle = gains[m, 2] + slow * gains[m, 3] * integral[i]
            angle += gains[m, 4] / slow * derivative[i]
            loop = base[i] * rate * (hold[i] + angle * lean[i])
            away = 1.0 + loop
            distance = away.real * away.real + away.imag * away.imag
            least = min(least, distance)
            yields = max(yields, push[i] * push[i] / distance)
            turned = math.atan2(loop.imag, loop.real)
            delay_phase = turned + late[i]
            if i == 0:
                # -90 to -450 deg: the integrals and what lags before the lowest frequency
                if turned > 0.0:
                    turned -= 2.0 * math.pi
                phase, delayed = turned, turned + late[0]
            else:
                phase += (turned - phase + math.pi) % (2.0 * math.pi) - math.pi
                delayed += (delay_phase - delayed + math.pi) % (2.0 * math.pi) - math.pi
            if loop.real * loop.real + loop.imag * loop.imag > 1.0:
                reach, reach_late = phase, delayed
                lost = i == len(base) - 1
        peak[m], compliance[m] = 1.0 / math.sqrt(least), math.sqrt(yields)
        stable = reach == -math.inf or (reach > -math.pi and reach_late > -math.pi)
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
            f.rate_kp[i], f.rate_ki[i], f.rate_kd[i] = rest.rate_kp[i], rest.rate_ki[i], 0.0
            f.angle_kp[i], f.angle_ki[i], f.angle_kd[i] = rest.angle_kp[i], rest.angle_ki[i], 0.0
        f.quaternion[0] = 1.0
        f.rate_kp[axis], f.rate_ki[axis] = gains[m, 0], gains[m, 1]
        f.angle_kp[axis], f.angle_ki[axis] = gains[m, 2], gains[m, 3]
        f.angle_kd[axis] = gains[m, 4]
        cascade_run(p, f, setpoints, thrust, supply_mv, period, start_rev_s, angles, gyro, compare)
        largest = 0.0
        for k in range(rows):
            y[m, k] = (gyro[k, axis] if axis == 2 else angles[k, axis]) / size
            for i in range(4):
                largest = max(largest, abs(compare[k, i] - thrust[k] / 128.0))
        effort[m] = largest / 512.0
