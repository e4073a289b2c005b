"""Compiled loops: linear, the firmware's, the thesis's."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.compiled import kernel, spliced
from groundstation.dynamics import sensing as quaternion
from groundstation.dynamics.craft import SENSOR_STATES
from groundstation.dynamics.kernels import (
    ALL,
    armature,
    body_slope,
    craft_step,
    motor_slopes,
    normalise,
    physics,
)
from groundstation.dynamics.sensing import (
    ROOM,
    SMOOTHING,
    UNSMOOTHED,
    begin,
    carried,
    estimated,
    follow,
    fuse,
    sense,
    smoothed,
)
from groundstation.dynamics.vehicle import PWM_FULL
from groundstation.telemetry.packet import FULL_16_BIT

# Compiled loops on linear models: PID on ARX polynomials, their stability and sensitivity.
#
# Imported only where a loop is closed. One file, because the compiler's cache looks at the entry
# point's own file only.


BAND = 0.05
TAIL = 0.1
"""The band of settling, and the share of the window over which the settled value is taken."""


@kernel
def measure(y: Any, period: float, band: float, out: Any) -> None:
    """Metrics (``metrics.py``) of a response to a unit step: fills rms, overshoot in percent,
    settling into a band (NaN: not settled), steady-state error."""
    rows = len(y)
    square, highest = 0.0, -math.inf
    for k in range(rows):
        square += (1.0 - y[k]) * (1.0 - y[k])
        highest = max(highest, y[k])
    tail = max(1, int(TAIL * rows + 0.5))
    settled = 0.0
    for k in range(rows - tail, rows):
        settled += y[k]
    settled /= tail
    last = rows - 1
    while last >= 0 and abs(y[last] - settled) <= band:
        last -= 1
    out[0] = math.sqrt(square / rows)
    out[1] = max(0.0, 100.0 * (highest - 1.0))
    out[2] = math.nan
    if math.isfinite(square) and last < rows - tail:
        out[2] = (last + 1) * period
    out[3] = 1.0 - settled


@kernel
def measure_many(y: Any, period: float, band: float, out: Any) -> None:
    """``measure`` of responses (m, k), into out (m, 4 or more)."""
    for m in range(len(y)):
        measure(y[m], period, band, out[m])


@kernel
def direct_run(
    a: Any,
    b: Any,
    delay: int,
    gains: Any,
    period: float,
    reference: Any,
    y: Any,
    u: Any,
) -> None:
    """PID on A(q) y = q^-delay B(q) u: fills outputs and inputs, as long as the reference.

    a: (na,) from a1. b: (nb,) from b0. gains: kp, ki, kd.
    """
    kp, ki, kd = gains[0], gains[1], gains[2] / period
    integral, before = 0.0, 0.0
    na, nb = len(a), len(b)
    for k in range(len(reference)):
        value = 0.0
        for i in range(min(na, k)):
            value -= a[i] * y[k - 1 - i]
        for i in range(nb):
            at = k - delay - i
            if at >= 0 and at < k:
                value += b[i] * u[at]
        y[k] = value
        error = reference[k] - value
        u[k] = kp * error + ki * integral + kd * (error - before)
        integral += period * error
        before = error


@kernel
def characteristic(a: Any, b: Any, delay: int, gains: Any, period: float, out: Any) -> int:
    """Fills the closed loop's characteristic polynomial in q^-1, lowest power first; its length.

    A (1 - q^-1) + q^-delay B C, the factor 1 - q^-1 only where there is an integral.
    """
    kp, ki, kd = gains[0], gains[1], gains[2] / period
    for i in range(len(out)):
        out[i] = 0.0
    na, nb = len(a), len(b)
    out[0] = 1.0
    for i in range(na):
        out[i + 1] += a[i]
    if ki != 0.0:
        for i in range(na + 1, 0, -1):
            out[i] -= out[i - 1]
        numerator = (kp + kd, period * ki - kp - 2.0 * kd, kd)
        size = na + 2
    else:
        numerator = (kp + kd, -kd, 0.0)
        size = na + 1
    for i in range(nb):
        for j in range(3):
            out[delay + i + j] += b[i] * numerator[j]
    return max(size, delay + nb + 2)


@kernel
def inside_unit_circle(polynomial: Any, size: int) -> bool:
    """Whether every root of a polynomial in q^-1 (lowest power first) has |z| < 1 (Jury).

    Destroys its argument.
    """
    top = size - 1
    while top > 0 and polynomial[top] == 0.0:
        top -= 1
    while top > 0:
        ratio = polynomial[top] / polynomial[0]
        if not abs(ratio) < 1.0:
            return False
        for i in range((top + 1) // 2):
            low, high = polynomial[i], polynomial[top - i]
            polynomial[i] = low - ratio * high
            polynomial[top - i] = high - ratio * low
        if top % 2 == 0:
            polynomial[top // 2] *= 1.0 - ratio
        top -= 1
    return True


@kernel
def sensitivity_peak(plant: Any, z: Any, gains: Any, period: float) -> float:
    """max |1 / (1 + P C)| over a grid: plant response and z = exp(i omega Ts), complex (n,)."""
    kp, ki, kd = gains[0], gains[1], gains[2] / period
    least = math.inf
    for i in range(len(z)):
        controller = kp + ki * period / (z[i] - 1.0) + kd * (1.0 - 1.0 / z[i])
        away = 1.0 + plant[i] * controller
        least = min(least, away.real * away.real + away.imag * away.imag)
    return 1.0 / math.sqrt(least)


@kernel
def judge_many(
    a: Any,
    b: Any,
    delay: int,
    spare: int,
    plant: Any,
    z: Any,
    candidates: Any,
    period: float,
    reference: Any,
    out: Any,
) -> None:
    """Judge gains (m, 3): fills (m, 6) with rms, overshoot, settling, steady-state error,
    maximum sensitivity and effort, the largest |u|. Unstable, or unstable with ``spare`` more
    samples of delay: all infinite."""
    rows = len(reference)
    y, u = np.empty(rows), np.empty(rows)
    polynomial = np.empty(delay + spare + len(a) + len(b) + 4)
    for m in range(len(candidates)):
        gains = candidates[m]
        stable = True
        for late in (delay, delay + spare):
            size = characteristic(a, b, late, gains, period, polynomial)
            stable = stable and inside_unit_circle(polynomial, size)
        if not stable:
            for i in range(6):
                out[m, i] = math.inf
            continue
        out[m, 4] = sensitivity_peak(plant, z, gains, period)
        direct_run(a, b, delay, gains, period, reference, y, u)
        measure(y, period, BAND, out[m])
        out[m, 5] = 0.0
        for k in range(rows):
            out[m, 5] = max(out[m, 5], abs(u[k]))


# The craft of ``simulate`` in a compiled closed loop: one period of it, and of polynomials.


ROTOR = 13
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@spliced
def move(p: Any, duty: Any, supply: Any, k: int, period: float, y: Any, work: Any) -> Any:
    """The craft over one period on duties (4); the armature voltages."""
    n = (y[13], y[14], y[15], y[16])
    volts = armature(p, duty, supply[k], supply[max(k - 1, 0)], period, n)
    craft_step((p, volts, STILL), period, len(y), y, work[0], work[1], work[2])
    normalise(y)
    return volts


@spliced
def body_on(p: Any, volts: Any, y: Any, dy: Any) -> Any:
    """The body at a state, its rotors on armature voltages (4)."""
    n = (y[13], y[14], y[15], y[16])
    return body_slope(p, n, motor_slopes(p, volts, n, ALL), STILL, y, dy, ALL)


@spliced
def answer(a: Any, b: Any, nk: Any, k: int, inputs: Any, outputs: Any) -> None:
    """Outputs (n, 3) of polynomials a (3, na), b (3, nb), nk (3,) at row k, from rows before it and
    inputs (n, 3) up to it; those not known yet are 0."""
    for axis in range(3):
        value = 0.0
        for i in range(min(a.shape[1], k)):
            value -= a[axis, i] * outputs[k - 1 - i, axis]
        for j in range(b.shape[1]):
            at = k - nk[axis] - j
            if at >= 0:
                value += b[axis, j] * inputs[at, axis]
        outputs[k, axis] = value


# What the firmware computes in its loops, compiled: PIDs, thrust curve, attitude filter. ``f`` is
# its state (``firmware_loop.py``).


@spliced
def update(
    f: Any,
    kind: int,
    axis: int,
    error: float,
    dt: float,
    limit: float,
    kp: float,
    ki: float,
    kd: float,
) -> float:
    """One PID of release 2014.01.0: its integral is clamped, at -5000 below, its output is not."""
    value = min(max(f.integral[kind, axis] + error * dt, -5000.0), limit)
    f.integral[kind, axis] = value
    output = kp * error + ki * value + kd * (error - f.previous[kind, axis]) / dt
    f.previous[kind, axis] = error
    return float(output)


@spliced
def rate_pid(f: Any, axis: int, error: float) -> float:
    """A rate PID as the clamp macro evaluates it: up to three times, within 16 bits."""
    output = 0.0
    for evaluation in range(3):
        output = update(
            f,
            1,
            axis,
            error,
            0.002,
            f.rate_limit[axis],
            f.rate_kp[axis],
            f.rate_ki[axis],
            f.rate_kd[axis],
        )
        if evaluation == 0 and output < -32768.0:
            break
        if evaluation == 1 and output > 32767.0:
            break
    return min(max(output, -32768.0), 32767.0)


@spliced
def update_today(
    f: Any,
    kind: int,
    axis: int,
    error: float,
    measured: float,
    limit: float,
    kp: float,
    ki: float,
    kd: float,
) -> float:
    """One PID of today's firmware: the derivative is that of what is measured, in deg or deg/s."""
    value = min(max(f.integral[kind, axis] + error * 0.002, -limit), limit)
    f.integral[kind, axis] = value
    change = measured - f.previous[kind, axis]
    if kind == 0:
        change = wrapped(change)
    f.previous[kind, axis] = measured
    return float(kp * error + ki * value - kd * change / 0.002)


@spliced
def rate_today(f: Any, axis: int, wanted: float, measured: float) -> float:
    output = update_today(
        f,
        1,
        axis,
        wanted - measured,
        measured,
        f.rate_limit[axis],
        f.rate_kp[axis],
        f.rate_ki[axis],
        f.rate_kd[axis],
    )
    return min(max(output, -32767.0), 32767.0)


@spliced
def wrapped(degrees: float) -> float:
    """The same direction within half a turn."""
    return (degrees + 180.0) % 360.0 - 180.0


@spliced
def compensated(f: Any, thrust: float, supply_v: float) -> float:
    """PWM (16 bits, not yet limited) by which the firmware's thrust curve gives a thrust."""
    if thrust <= 0.0:
        return 0.0
    wanted, volts = thrust / FULL_16_BIT * f.most_n, 2.0
    c = f.curve
    for _ in range(6):
        value = c[0] + volts * (c[1] + volts * (c[2] + volts * c[3])) - wanted
        slope = c[1] + volts * (2.0 * c[2] + 3.0 * volts * c[3])
        volts = min(max(volts - value / slope, 0.0), 5.0)
    return volts / supply_v * FULL_16_BIT


@spliced
def fused(f: Any, gyro: Any, felt: Any) -> Any:
    """The firmware's Mahony update at 250 Hz; returns its quaternion."""
    q, kept = f.quaternion, f.feedback
    gains = (0.5 * f.fusion_kp, 0.5 * f.fusion_ki)
    integral = (kept[0], kept[1], kept[2])
    turned, integral = fuse((q[0], q[1], q[2], q[3]), integral, gyro, felt, gains, 0.004)
    q[0], q[1], q[2], q[3] = turned
    kept[0], kept[1], kept[2] = integral
    return turned


# The firmware's cascade around the craft of ``simulate``, compiled.


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
def cascade_margins(
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
    peak: Any,
    compliance: Any,
) -> None:
    """Margins of gains (m, 6), rate kp and ki, angle kp, ki and kd, rate kd, of one axis.

    The loop at n frequencies is base ((rate) (hold + (angle) lean) + rate derivative hold), with
    the responses of an integral, of the derivatives of angle and rate, and of the craft to a push;
    fast and slow the firmware's factors on integrals, late the phase of more delay. Fills
    peak (m,), the maximum sensitivity, inf where the loop is unstable, and compliance (m,), how
    far a push of 1 rad/s^2 moves it at worst.
    """
    for m in range(len(gains)):
        yields, least, phase, delayed, lost = 0.0, math.inf, 0.0, 0.0, False
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
        if lost or not (reach > -math.pi and reach_late > -math.pi):
            peak[m] = math.inf


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
    size: float,
    thrust: Any,
    level: Any,
    supply_mv: Any,
    period: float,
    effort: Any,
    y: Any,
) -> None:
    """Fly gains (m, 6) as ``cascade_margins`` orders them through a step of ``size`` of one axis;
    level (k,): the steps of 1/512 of full PWM that hold the hover.

    Fills effort (m,), the largest step of a motor, 0..1; y (m, k), the response over ``size``.
    ``rest`` is the firmware at rest, ``f`` room for its state.
    """
    rows = y.shape[1]
    setpoints = np.zeros((rows, 3))
    setpoints[:, axis] = size
    angles, gyro, compare = np.zeros((rows, 3)), np.zeros((rows, 3)), np.zeros((rows, 4))
    for m in range(len(gains)):
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


# The compiled closed loop of the thesis's Figure 8.10, with the craft of ``simulate``.


@kernel
def whole_run(
    craft: Any,
    mixer: Any,
    start: Any,
    arx_a: Any,
    arx_b: Any,
    arx_nk: Any,
    polynomials: bool,
    gains: Any,
    thrust: Any,
    supply_mv: Any,
    reference: Any,
    period: float,
    delay: int,
    angles: Any,
    controls: Any,
    pwm: Any,
) -> None:
    """The whole simulation of thesis Figure 8.10, as long as ``reference`` (k, 3) in rad.

    polynomials: whether they turn the craft (arx_a (3, na), arx_b (3, nb), arx_nk (3,), the delays
    inside), otherwise the rigid body. mixer: (3, 4). start: the state. delay: samples from the
    body's angle to the controller. gains (3, 3): kp, ki, kd per axis in PWM counts; thrust (k,)
    counts, supply (k,) mV. Fills angles (k, 3) as the controller hears them, controls (k, 3) and
    pwm (k, 4) in counts.
    """
    p, rows = physics(craft), len(reference)
    half = 1.0 if mixer[0, 0] == 0.0 else 0.5  # in X two rotors on a side share roll and pitch
    y, work = start.copy(), np.zeros((3, len(start)))
    torque = np.zeros((rows, 3))
    true = np.zeros((rows, 3))
    integral, before, duty = np.zeros(3), np.zeros(3), np.zeros(4)
    for k in range(rows):
        if polynomials:
            answer(arx_a, arx_b, arx_nk, k, torque, angles)
        else:
            turned = quaternion.angles((y[6], y[7], y[8], y[9]))
            true[k, 0], true[k, 1], true[k, 2] = turned
            for axis in range(3):
                angles[k, axis] = true[k - delay, axis] if k >= delay else 0.0
        for axis in range(3):
            error = reference[k, axis] - angles[k, axis]
            wanted = gains[axis, 0] * error + gains[axis, 1] * integral[axis]
            wanted += gains[axis, 2] * (error - before[axis]) / period
            integral[axis] += period * error
            before[axis] = error
            controls[k, axis] = min(max(wanted, -PWM_FULL), PWM_FULL)
        for i in range(4):
            shared = half * (mixer[0, i] * controls[k, 0] + mixer[1, i] * controls[k, 1])
            counts = thrust[k] + shared + mixer[2, i] * controls[k, 2]
            pwm[k, i] = min(max(counts, 0.0), PWM_FULL)
            duty[i] = pwm[k, i] / PWM_FULL
        for axis in range(3):
            for i in range(4):
                torque[k, axis] += mixer[axis, i] * y[ROTOR + i] * y[ROTOR + i]
        move(p, (duty[0], duty[1], duty[2], duty[3]), supply_mv, k, period, y, work)
