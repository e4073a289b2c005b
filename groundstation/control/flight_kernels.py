"""Compiled closed loops with the craft of ``simulate``: the thesis's Figure 8.10, and the
firmware's cascade.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.control.plant import RATES
from groundstation.dynamics import quaternion
from groundstation.dynamics.arx import SLOPE_ROWS
from groundstation.dynamics.attitude_filter import SMOOTHING, UNSMOOTHED, fuse, smoothed
from groundstation.dynamics.compiled import kernel, spliced
from groundstation.dynamics.craft import SENSOR_STATES
from groundstation.dynamics.kernels import craft_step, normalise
from groundstation.dynamics.mixer import PWM_FULL
from groundstation.dynamics.motor_kernels import armature
from groundstation.dynamics.rigid_body import ALL, body_slope, motor_slopes, physics
from groundstation.dynamics.sensing import begin, estimated, follow, sense
from groundstation.telemetry.packet import FULL_16_BIT

DEGREES = 180.0 / math.pi
ROTOR, RATE = 13, 10
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@spliced
def _move(p: Any, duty: Any, supply: Any, k: int, period: float, y: Any, work: Any) -> Any:
    """The craft over one period on duties (4); the armature voltages."""
    n = (y[13], y[14], y[15], y[16])
    volts = armature(p, duty, supply[k], supply[max(k - 1, 0)], period, n)
    craft_step((p, volts, STILL), period, len(y), y, work[0], work[1], work[2])
    normalise(y)
    return volts


@spliced
def _body(p: Any, volts: Any, y: Any, dy: Any) -> Any:
    """The body at a state, its rotors on armature voltages (4)."""
    n = (y[13], y[14], y[15], y[16])
    return body_slope(p, n, motor_slopes(p, volts, n, ALL), STILL, y, dy, ALL)


@spliced
def _answer(a: Any, b: Any, nk: Any, k: int, inputs: Any, outputs: Any) -> None:
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


@kernel
def whole_run(
    craft: Any,
    mixer: Any,
    start: Any,
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
    delay: int,
    angles: Any,
    controls: Any,
    pwm: Any,
) -> None:
    """The whole simulation of thesis Figure 8.10, as long as ``reference`` (k, 3) in rad.

    body: 0 ARX (arx_a (3, na), arx_b (3, nb), arx_nk (3,), the delays inside), 1 grey box
    (decoupled accelerations, thesis 3.58-3.60), 2 rigid body. mixer: (3, 4). start: the state.
    delay: samples from angle to controller, for bodies 1 and 2. gains (3, 3): kp, ki, kd per axis
    in PWM counts; thrust (k,) counts, supply (k,) mV. Fills angles (k, 3) as the controller hears
    them, controls (k, 3) and pwm (k, 4) in counts.
    """
    p, rows = physics(craft), len(reference)
    half = 1.0 if mixer[0, 0] == 0.0 else 0.5  # in X two rotors on a side share roll and pitch
    y, work = start.copy(), np.zeros((3, len(start)))
    grey = np.zeros(3)
    torque = np.zeros((rows, 3))
    true = np.zeros((rows, 3))
    integral, before, duty = np.zeros(3), np.zeros(3), np.zeros(4)
    for k in range(rows):
        if body == 0:
            _answer(arx_a, arx_b, arx_nk, k, torque, angles)
        else:
            if body == 1:
                for axis in range(3):
                    true[k, axis] = grey[axis]
            else:
                turned = quaternion.angles((y[6], y[7], y[8], y[9]))
                true[k, 0], true[k, 1], true[k, 2] = turned
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
            shared = half * (mixer[0, i] * controls[k, 0] + mixer[1, i] * controls[k, 1])
            counts = thrust[k] + shared + mixer[2, i] * controls[k, 2]
            pwm[k, i] = min(max(counts, 0.0), PWM_FULL)
            duty[i] = pwm[k, i] / PWM_FULL
        for axis in range(3):
            for i in range(4):
                torque[k, axis] += mixer[axis, i] * y[ROTOR + i] * y[ROTOR + i]
            grey[axis] += 0.5 * period * y[RATE + axis]
        _move(p, (duty[0], duty[1], duty[2], duty[3]), supply_mv, k, period, y, work)
        for axis in range(3):
            grey[axis] += 0.5 * period * y[RATE + axis]


@spliced
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


@spliced
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


@spliced
def _update_today(
    f: Any, kind: int, axis: int, error: float, measured: float, limit: float, kp: float,
    ki: float, kd: float,
) -> float:  # fmt: skip
    """One PID of today's firmware: the derivative is that of what is measured, in deg or deg/s."""
    value = min(max(f.integral[kind, axis] + error * 0.002, -limit), limit)
    f.integral[kind, axis] = value
    change = measured - f.previous[kind, axis]
    if kind == 0:
        change = _turned(change)
    f.previous[kind, axis] = measured
    return float(kp * error + ki * value - kd * change / 0.002)


@spliced
def _rate_today(f: Any, axis: int, wanted: float, measured: float) -> float:
    output = _update_today(
        f, 1, axis, wanted - measured, measured, f.rate_limit[axis],
        f.rate_kp[axis], f.rate_ki[axis], f.rate_kd[axis],
    )  # fmt: skip
    return min(max(output, -32767.0), 32767.0)


@spliced
def _turned(degrees: float) -> float:
    """The same direction within half a turn."""
    return (degrees + 180.0) % 360.0 - 180.0


@spliced
def _compensated(f: Any, thrust: float, supply_v: float) -> float:
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
def _fuse(f: Any, gyro: Any, felt: Any) -> Any:
    """The firmware's Mahony update at 250 Hz; returns its quaternion."""
    q, kept = f.quaternion, f.feedback
    gains = (0.5 * f.fusion_kp, 0.5 * f.fusion_ki)
    integral = (kept[0], kept[1], kept[2])
    turned, integral = fuse((q[0], q[1], q[2], q[3]), integral, gyro, felt, gains, 0.004)
    q[0], q[1], q[2], q[3] = turned
    kept[0], kept[1], kept[2] = integral
    return turned


@spliced
def _turn(
    turns: int, a: Any, b: Any, nk: Any, period: float, k: int, inputs: Any, outputs: Any, y: Any
) -> None:  # fmt: skip
    """Rates, and angles where the polynomials are theirs, of row k into the state."""
    _answer(a, b, nk, k, inputs, outputs)
    if turns == RATES:
        for axis in range(3):
            y[RATE + axis] = outputs[k, axis]
    else:
        roll, pitch, yaw = outputs[k, 0], outputs[k, 1], outputs[k, 2]
        turned = quaternion.of_angles((roll, pitch, yaw))
        y[6], y[7], y[8], y[9] = turned
        past, span = max(k - SLOPE_ROWS, 0), SLOPE_ROWS * period
        droll = (roll - outputs[past, 0]) / span
        dpitch = (pitch - outputs[past, 1]) / span
        dyaw = (yaw - outputs[past, 2]) / span
        y[RATE] = droll - math.sin(pitch) * dyaw
        y[RATE + 1] = math.cos(roll) * dpitch + math.cos(pitch) * math.sin(roll) * dyaw
        y[RATE + 2] = math.cos(pitch) * math.cos(roll) * dyaw - math.sin(roll) * dpitch


@kernel
def cascade_run(
    craft: Any,
    sensor: Any,
    airframe_x: bool,
    fusion: bool,
    turns: int,
    arx_a: Any,
    arx_b: Any,
    arx_nk: Any,
    mixer: Any,
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
    turns: what turns the craft (``plant.Polynomials``): 0 the body, 1 polynomials of angles, 2 of
    rates, arx_a (3, na), arx_b (3, nb), arx_nk (3,) on the u' of mixer (3, 4).
    ``f`` holds the firmware's state and is changed.
    """
    p, rows = physics(craft), len(setpoints)
    y, work, z = start.copy(), np.zeros((3, len(start))), np.zeros((4, SENSOR_STATES))
    late = sensor.delay / period if turns == 0 else 0.0  # polynomials have their own
    depth = int(late) + 2
    past = np.zeros((depth, 10))
    mount = (sensor.mount[0], sensor.mount[1], sensor.mount[2], sensor.mount[3])
    found, mixed, desired, duty = np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(4)
    angle_dt = 0.002 if f.quirk_attitude_dt != 0 else 0.004
    n = (y[13], y[14], y[15], y[16])
    still = (0.0, 0.0, 0.0, 0.0)
    before = body_slope(p, n, still, STILL, y, work[0], ALL)
    begin(craft, before, z[0])
    felt, volts = before.force, still
    smoothing = SMOOTHING if f.today == 0 else UNSMOOTHED
    kept = rows if turns != 0 else 0
    inputs, outputs = np.zeros((kept, 3)), np.zeros((kept, 3))
    for k in range(rows):
        now = past[k % depth]
        if turns != 0:
            _turn(turns, arx_a, arx_b, arx_nk, period, k, inputs, outputs, y)
        if k > 0:
            after = _body(p, volts, y, work[0])
            follow(craft, before, after, period, z)
            before = after
        reading = sense(p, before, z[0], z[1])
        felt = smoothed(felt, reading.accelerometer, period, smoothing)
        q = (y[6], y[7], y[8], y[9])
        if turns == 0:
            q = estimated(craft, q, z[0])
        now[0], now[1], now[2], now[3] = q
        for axis in range(3):
            heard = reading.gyro[axis] - sensor.zero[axis]
            now[4 + axis] = heard if turns == 0 else y[RATE + axis]
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
                q = _fuse(f, rate, (past[low, 7], past[low, 8], past[low, 9]))
            else:
                q = (past[low, 0], past[low, 1], past[low, 2], past[low, 3])
                if turns == 0:
                    q = quaternion.product(q, mount)
            found[0], found[1], found[2] = quaternion.angles(q)
        # the firmware's degrees, pitch nose up
        if f.today != 0:
            f.heading = _turned(f.heading + DEGREES * setpoints[k, 2] * period)
            for axis in range(3):
                sign = -1.0 if axis == 1 else 1.0
                at_deg = sign * DEGREES * found[axis]
                goal = f.heading if axis == 2 else sign * DEGREES * setpoints[k, axis]
                desired[axis] = _update_today(
                    f, 0, axis, _turned(goal - at_deg), at_deg, f.angle_limit[axis],
                    f.angle_kp[axis], f.angle_ki[axis], f.angle_kd[axis],
                )  # fmt: skip
        elif k % 2 == 0:
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
        if f.today != 0:
            roll = _rate_today(f, 0, desired[0], DEGREES * gyro[k, 0])
            pitch = _rate_today(f, 1, desired[1], -DEGREES * gyro[k, 1])
            yaw = -_rate_today(f, 2, desired[2], DEGREES * gyro[k, 2])
        else:
            roll = _rate_pid(f, 0, desired[0] - DEGREES * gyro[k, 0])
            pitch = _rate_pid(f, 1, desired[1] + DEGREES * gyro[k, 1])
            yaw = -_rate_pid(f, 2, desired[2] - DEGREES * gyro[k, 2])
            if yaw > 32767.0:
                yaw = -32768.0 if f.quirk_negate != 0 else 32767.0
        if airframe_x:
            roll, pitch = 0.5 * roll, 0.5 * pitch
            if f.quantised != 0:
                roll, pitch = math.floor(roll), math.floor(pitch)
            mixed[0], mixed[1] = -roll + pitch + yaw, -roll - pitch - yaw
            mixed[2], mixed[3] = roll - pitch + yaw, roll + pitch - yaw
        else:
            mixed[0], mixed[1] = pitch + yaw, -roll - yaw
            mixed[2], mixed[3] = -pitch + yaw, roll - yaw
        beyond = 0.0
        if f.today != 0:
            for i in range(4):
                mixed[i] = _compensated(f, thrust[k] + mixed[i], supply_mv[k] / 1000.0)
                beyond = max(beyond, mixed[i] - FULL_16_BIT)
        for i in range(4):
            # today's lowers all motors together: attitude comes before thrust
            wanted = mixed[i] - beyond if f.today != 0 else thrust[k] + mixed[i]
            steps = min(max(wanted, 0.0), FULL_16_BIT) / 128.0
            if f.quantised != 0:
                steps = float(int(steps))
            compare[k, i] = steps
            duty[i] = steps / 512.0
        driven = (duty[0], duty[1], duty[2], duty[3])
        speed = (y[13], y[14], y[15], y[16])
        volts = _move(p, driven, supply_mv, k, period, y, work)
        if turns != 0 and k + 1 < rows:
            for i in range(4):
                end = y[ROTOR + i]
                square = (speed[i] * speed[i] + speed[i] * end + end * end) / 3.0
                for axis in range(3):
                    inputs[k + 1, axis] += mixer[axis, i] * square


@kernel
def cascade_many(
    craft: Any,
    sensor: Any,
    airframe_x: bool,
    fusion: bool,
    turns: int,
    arx_a: Any,
    arx_b: Any,
    arx_nk: Any,
    mixer: Any,
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
    began: float,
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
    began is the phase of base at the first of them, not wrapped;
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
                # the phases of base and gains, not wrapped: integrals and unstable poles count
                expected = began + math.atan2(rate.imag, rate.real)
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
            craft, sensor, airframe_x, fusion, turns, arx_a, arx_b, arx_nk, mixer,
            start, f, setpoints, thrust, supply_mv, period, angles, gyro, compare,
        )  # fmt: skip
        largest = 0.0
        for k in range(rows):
            y[m, k] = (gyro[k, axis] if axis == 2 else angles[k, axis]) / size
            for i in range(4):
                largest = max(largest, abs(compare[k, i] - level[k]))
        effort[m] = largest / 512.0
