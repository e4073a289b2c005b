"""Compiled loops of fits and search."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.compiled import kernel, spliced
from groundstation.dynamics.chains import call_law
from groundstation.dynamics.effect import STATE_SLOTS
from groundstation.dynamics.kernels import runge_kutta
from groundstation.dynamics.sensing import to_body, to_inertial

# Compiled loops of the search: rotors with what may be missing, and causal estimates of motion.
#
# Imported only where something is computed. Everything here looks at the past only: in closed loop
# a regressor that knows the present row's noise, or the future's, is taken for physics.


@spliced
def _law_slope(context: Any, half: int, y: Any, dy: Any) -> None:
    address, values, given, x, size, passed = context
    numbers = len(passed)
    for i in range(len(y)):
        given[size + i] = y[i]
    x[:numbers] = passed
    call_law(address, values, given, x)
    for i in range(len(y)):
        dy[i] = x[numbers + i]


_law_step = runge_kutta(_law_slope)


@kernel
def run_law(
    address: int,
    values: Any,
    craft: Any,
    rows: Any,
    initial: Any,
    period: float,
    substeps: int,
    mean: bool,
    out: Any,
) -> None:
    """One effect's law along rows of motion (n, numbers) that last over the period before each.

    address, values: of ``dynamics.chains.own_address``. craft: its numbers. initial: states before
    the first row, which are at their mean over the period (mean) or at the row where the law is
    asked. out: (n, numbers) what is passed to the law, and then what it returns.
    """
    size, numbers, states = len(craft) + rows.shape[1], out.shape[1], len(initial)
    given, x = np.zeros(size + STATE_SLOTS), np.zeros(numbers + STATE_SLOTS)
    y, before, dy = initial.copy(), initial.copy(), np.zeros(states)
    base, total = np.zeros(states), np.zeros(states)
    given[: len(craft)] = craft
    passed = np.zeros(numbers)
    context = (address, values, given, x, size, passed)
    for k in range(len(rows)):
        passed[:] = out[k]
        given[len(craft) : size] = rows[k]
        if states > 0 and k > 0:
            before[:] = y
            for _ in range(substeps):
                _law_step(context, period / substeps, states, y, dy, base, total)
        for i in range(states):
            given[size + i] = 0.5 * (before[i] + y[i]) if mean else y[i]
        x[:numbers] = passed
        call_law(address, values, given, x)
        out[k] = x[:numbers]


@kernel
def predict_rates(
    gyro: Any,
    known: Any,
    acceleration: Any,
    period: float,
    gain: Any,
    first: int,
    out: Any,
    news: Any,
) -> Any:
    """Mean rate over the period that ends with each row, from rows before it alone.

    A steady-state Kalman filter per axis: acceleration (n, 3) is the model's mean over the
    period, gain (3,) how far a measured rate is believed. Rows that are not known are not
    believed at all. Fills out (n, 3) and news (n, 3), measured less predicted rate at each row;
    returns the mean square of that (3,).
    """
    rows = gyro.shape[0]
    error = [0.0, 0.0, 0.0]
    for axis in range(3):
        rate = gyro[first, axis]
        total = 0.0
        for k in range(first + 1):
            out[k, axis] = gyro[k, axis]
        for k in range(first + 1, rows):
            step = acceleration[k, axis] * period
            out[k, axis] = rate + 0.5 * step
            rate += step
            if known[k]:
                wrong = gyro[k, axis] - rate
                news[k, axis] = wrong
                total += wrong * wrong
                rate += gain[axis] * wrong
        error[axis] = total / max(rows - first - 1, 1)
    return error[0], error[1], error[2]


@kernel
def body_velocity(
    orientation: Any,
    force: Any,
    gravity: float,
    period: float,
    leak_s: float,
    first: int,
    start: Any,
    out: Any,
) -> None:
    """Body velocity (n, 3) at each row from quaternions (4, n) and specific force (n, 3) before it.

    start: (3,) inertial velocity up to row ``first``.

    The inertial acceleration is integrated with two leaks of time constant ``leak_s``: what an
    offset of the accelerometer or a tilt of the frame would add dies out, and so does true
    velocity that lasts longer.
    """
    vx, vy, vz = start[0], start[1], start[2]
    mx, my, mz = 0.0, 0.0, 0.0
    keep = math.exp(-period / leak_s)
    ax, ay, az = 0.0, 0.0, 0.0
    for k in range(force.shape[0]):
        q = (orientation[0, k], orientation[1, k], orientation[2, k], orientation[3, k])
        if k > first:
            # The acceleration of the row before acted up to this row.
            vx = keep * (vx + period * ax)
            vy = keep * (vy + period * ay)
            vz = keep * (vz + period * az)
            mx += (1.0 - keep) * (vx - mx)
            my += (1.0 - keep) * (vy - my)
            mz += (1.0 - keep) * (vz - mz)
        out[k, 0], out[k, 1], out[k, 2] = to_body(q, (vx - mx, vy - my, vz - mz))
        ax, ay, az = to_inertial(q, (force[k, 0], force[k, 1], force[k, 2]))
        az -= gravity


@kernel
def carried_rotation(reported: Any, gyro: Any, period: float, follow_s: float, out: Any) -> None:
    """Rotation matrices (n, 3, 3), body to inertial, that the gyro (n, 3) carries on from the
    first row.

    ``reported`` (n, 3, 3) is followed with a time constant ``follow_s``, so that no drift lasts.
    """
    m, turned = reported[0].copy(), np.empty((3, 3))
    for k in range(len(reported)):
        if k > 0:
            r = reported[k]
            half = 0.5 * period
            x = half * (gyro[k, 0] + gyro[k - 1, 0])
            y = half * (gyro[k, 1] + gyro[k - 1, 1])
            z = half * (gyro[k, 2] + gyro[k - 1, 2])
            # To the second order in the turn of one period, then back to the estimate.
            for i in range(3):
                a, b, c = m[i, 0], m[i, 1], m[i, 2]
                da, db, dc = b * z - c * y, c * x - a * z, a * y - b * x
                turned[i, 0] = a + da + 0.5 * (db * z - dc * y)
                turned[i, 1] = b + db + 0.5 * (dc * x - da * z)
                turned[i, 2] = c + dc + 0.5 * (da * y - db * x)
            n = turned
            # Half the sum of the cross products of both frames' axes: the turn between them.
            share = 0.5 * period / follow_s
            ex, ey, ez = 0.0, 0.0, 0.0
            for j in range(3):
                ex += share * (n[2, j] * r[1, j] - n[1, j] * r[2, j])
                ey += share * (n[0, j] * r[2, j] - n[2, j] * r[0, j])
                ez += share * (n[1, j] * r[0, j] - n[0, j] * r[1, j])
            for j in range(3):
                a, b, c = n[0, j], n[1, j], n[2, j]
                m[0, j] = a + ez * b - ey * c
                m[1, j] = b + ex * c - ez * a
                m[2, j] = c + ey * a - ex * b
            for i in range(3):
                size = math.sqrt(m[i, 0] ** 2 + m[i, 1] ** 2 + m[i, 2] ** 2)
                for j in range(3):
                    m[i, j] /= size
        out[k] = m


@kernel
def linear_filter(
    to: Any, of: Any, weight: Any, start: Any, first: int, values: Any, out: Any
) -> None:
    """[s_k, y_k] = M [s_(k-1), u_k, u_(k-1)] along rows u (n, m) into y (n, m).

    M[to, of] = weight (e,) where it is not zero. s is ``start`` before row ``first``; rows before
    that pass as they are.
    """
    states, axes = len(start), values.shape[1]
    given, found = np.zeros(states + 2 * axes), np.zeros(states + axes)
    given[:states] = start
    for i in range(axes):
        given[states + axes + i] = values[first, i]
    out[:first] = values[:first]
    for k in range(first, len(values)):
        for i in range(axes):
            given[states + i] = values[k, i]
        found[:] = 0.0
        for e in range(len(to)):
            found[to[e]] += weight[e] * given[of[e]]
        for i in range(states):
            given[i] = found[i]
        for i in range(axes):
            out[k, i] = found[states + i]
            given[states + axes + i] = values[k, i]


@kernel
def axes_filter(step: Any, start: Any, first: int, values: Any, out: Any) -> None:
    """``linear_filter`` of one filter of second order on each of three axes: step (3, 4), start
    (2, 3). Three chains side by side take as long as one."""
    a11, a12, b1, e1 = step[0, 0], step[0, 1], step[0, 2], step[0, 3]
    a21, a22, b2, e2 = step[1, 0], step[1, 1], step[1, 2], step[1, 3]
    c1, c2, d, f = step[2, 0], step[2, 1], step[2, 2], step[2, 3]
    px, py, pz = start[0, 0], start[0, 1], start[0, 2]
    qx, qy, qz = start[1, 0], start[1, 1], start[1, 2]
    ux, uy, uz = values[first, 0], values[first, 1], values[first, 2]
    out[:first] = values[:first]
    for k in range(first, len(values)):
        x, y, z = values[k, 0], values[k, 1], values[k, 2]
        out[k, 0] = c1 * px + c2 * qx + (d * x + f * ux)
        out[k, 1] = c1 * py + c2 * qy + (d * y + f * uy)
        out[k, 2] = c1 * pz + c2 * qz + (d * z + f * uz)
        sx, tx = (b1 * x + e1 * ux), (b2 * x + e2 * ux)
        sy, ty = (b1 * y + e1 * uy), (b2 * y + e2 * uy)
        sz, tz = (b1 * z + e1 * uz), (b2 * z + e2 * uz)
        px, qx = a11 * px + a12 * qx + sx, a21 * px + a22 * qx + tx
        py, qy = a11 * py + a12 * qy + sy, a21 * py + a22 * qy + ty
        pz, qz = a11 * pz + a12 * qz + sz, a21 * pz + a22 * qz + tz
        ux, uy, uz = x, y, z


@kernel
def first_order(values: Any, keep: float, out: Any) -> None:
    """y_k = keep y_(k-1) + (1 - keep) x_k along the rows of (n, m), settled at the first."""
    for j in range(values.shape[1]):
        state = values[0, j]
        for k in range(values.shape[0]):
            state += (1.0 - keep) * (values[k, j] - state)
            out[k, j] = state


@kernel
def late_rotors(
    end: Any, square: Any, late: float, period: float, mean: Any, last: Any, rotor: Any, slope: Any
) -> None:
    """Speeds (n, m), rev/s, and their mean squares over the period before each row, ``late`` rows
    later, as ``motion.Inputs`` has them: (m, n) each. The first and the last row go on for ever.

    Speeds are cubic through the four nearest rows. Straight between rows, half a row's delay would
    take noise out of measured speeds that a whole one leaves in, and a fit would take that for
    the delay. The integral of the squares is cubic with the squares at the rows for its slopes.
    """
    count, top = end.shape[0], end.shape[0] - 1
    whole = math.floor(late)
    t = 1.0 - (late - whole)
    s = 1.0 - t
    near_left, near_right = s * (1.0 + t) * (2.0 - t) / 2.0, t * (1.0 + t) * (2.0 - t) / 2.0
    far_left, far_right = t * s * (2.0 - t) / 6.0, t * s * (1.0 + t) / 6.0
    over, rise = t * t * (3.0 - 2.0 * t), t * t * (t - 1.0)
    start = t * s * s
    for j in range(end.shape[1]):
        before = end[0, j]
        for i in range(count):
            at = i - whole
            a, b = min(max(at - 2, 0), top), min(max(at - 1, 0), top)
            c, d = min(max(at, 0), top), min(max(at + 1, 0), top)
            now, power = end[i, j], square[i, j]
            if late != 0.0:
                now = near_left * end[b, j] + near_right * end[c, j]
                now -= far_left * end[a, j] + far_right * end[d, j]
                power = (1.0 - over) * square[b, j] + over * square[c, j]
                power += start * (end[b, j] ** 2 - end[a, j] ** 2)
                power += rise * (end[c, j] ** 2 - end[b, j] ** 2)
            if i == 0:
                before = now
            mean[j, i] = math.sqrt(max(power, 0.0))
            last[j, i] = now
            rotor[j, i] = 0.5 * (now + before)
            slope[j, i] = (now - before) / period
            before = now


# Compiled motor simulation with its sensitivities.


@kernel
def motor_sensitivities(
    constants: Any, voltage: Any, period: float, start: float, speed: Any, sensitivity: Any
) -> None:
    """Runge-Kutta (order 4) on n' = a0 u - a1 n - a2 n^2 and on its derivatives, with
    motor_dead_voltage, motor_coasting and motor_braking_asymmetry.

    constants: a0, a1, a2, dead voltage (mV), share, factor. voltage: (k,) mV; row i acts from row
    i - 1 to row i. Fills speed (k,) and sensitivity (k, 4 or 7): dn/da0, dn/da1, dn/da2, dn/dn(0)
    and, where there is room, by the three effects.
    """
    a0, a1, a2 = constants[0], constants[1], constants[2]
    dead, share, factor = constants[3], constants[4], constants[5]
    n = start
    columns = sensitivity.shape[1]
    s = np.zeros(columns)
    s[3] = 1.0
    speed[0] = n
    sensitivity[0] = s
    m, slope, gain, g, f = np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4)
    flows, push = np.zeros(4), np.zeros(4)
    h = period
    for k in range(1, len(voltage)):
        u = max(voltage[k] - dead, 0.0) if voltage[k] > 0.0 else 0.0
        for i in range(4):
            reach = 0.0 if i == 0 else (h if i == 3 else 0.5 * h)
            m[i] = n + reach * slope[i - 1] if i else n
            push[i] = a0 * u - a1 * m[i]
            flows[i] = 1.0 - share if push[i] < 0.0 else 1.0
            free = flows[i] * push[i] - a2 * m[i] * m[i]
            gain[i] = factor if free < 0.0 else 1.0
            slope[i] = gain[i] * free
            g[i] = gain[i] * (flows[i] * a1 + 2.0 * a2 * m[i])
        for j in range(columns):
            for i in range(4):
                if j == 0:
                    f[i] = gain[i] * flows[i] * u
                elif j == 1:
                    f[i] = -gain[i] * flows[i] * m[i]
                elif j == 2:
                    f[i] = -gain[i] * m[i] * m[i]
                elif j == 3:
                    f[i] = 0.0
                elif j == 4:
                    f[i] = -gain[i] * flows[i] * a0 if u > 0.0 else 0.0
                elif j == 5:
                    f[i] = -gain[i] * min(push[i], 0.0)
                else:
                    f[i] = slope[i] / factor if slope[i] < 0.0 else 0.0
            s[j] = _step(s[j], h, g[0], g[1], g[2], g[3], f[0], f[1], f[2], f[3])
        n += h / 6.0 * (slope[0] + 2.0 * (slope[1] + slope[2]) + slope[3])
        speed[k] = n
        sensitivity[k] = s


@spliced
def _step(
    s: float,
    h: float,
    g1: float,
    g2: float,
    g3: float,
    g4: float,
    f1: float,
    f2: float,
    f3: float,
    f4: float,
) -> float:
    k1 = f1 - g1 * s
    k2 = f2 - g2 * (s + 0.5 * h * k1)
    k3 = f3 - g3 * (s + 0.5 * h * k2)
    k4 = f4 - g4 * (s + h * k3)
    return s + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


# Compiled free runs of many ARX structures over the same data.


@kernel
def free_run_errors(
    orders: Any, a: Any, b: Any, inputs: Any, outputs: Any, window: int, first: int, sums: Any
) -> None:
    """Add each structure's sum of squared free-run errors over one run to ``sums`` (s,).

    orders: (s, 3) na, nb, nk. a: (s, 4) and b: (s, 4), zero beyond the order. Every ``window``
    rows from row ``first`` on, a run starts afresh from the measured outputs before it.
    """
    rows = len(inputs)
    for s in range(len(orders)):
        nb, nk = orders[s, 1], orders[s, 2]
        a1, a2, a3, a4 = a[s, 0], a[s, 1], a[s, 2], a[s, 3]
        total = 0.0
        t = first
        while t < rows:
            y1, y2, y3, y4 = outputs[t - 1], outputs[t - 2], outputs[t - 3], outputs[t - 4]
            for k in range(t, min(t + window, rows)):
                y = -(a1 * y1 + a2 * y2 + a3 * y3 + a4 * y4)
                for j in range(nb):
                    y += b[s, j] * inputs[k - nk - j]
                error = outputs[k] - y
                total += error * error
                y4, y3, y2, y1 = y3, y2, y1, y
            t += window
        sums[s] += total


@kernel
def steps_ahead(
    a: Any, b: Any, nk: int, inputs: Any, outputs: Any, steps: int, first: int, predicted: Any
) -> None:
    """Fill predicted[t] with the prediction of outputs[t] from outputs up to t - ``steps``.

    a: (4,), b: (nb,). Inputs are known up to t, as in any simulation.
    """
    a1, a2, a3, a4 = a[0], a[1], a[2], a[3]
    for t in range(first + steps - 1, len(outputs)):
        start = t - steps + 1
        y1, y2 = outputs[start - 1], outputs[start - 2]
        y3, y4 = outputs[start - 3], outputs[start - 4]
        y = 0.0
        for k in range(start, t + 1):
            y = -(a1 * y1 + a2 * y2 + a3 * y3 + a4 * y4)
            for j in range(len(b)):
                y += b[j] * inputs[k - nk - j]
            y4, y3, y2, y1 = y3, y2, y1, y
        predicted[t] = y


@kernel
def step_turns_one_way(a: Any, b: Any, nk: int, settled: int, rows: int) -> bool:
    """Whether the response to a unit step stays positive and never falls, from row ``nk`` +
    ``settled`` on for ``rows`` rows after the delay. a: (4,), b: (nb,)."""
    y1, y2, y3, y4 = 0.0, 0.0, 0.0, 0.0
    drive = 0.0
    for k in range(rows):
        if k < len(b):
            drive += b[k]
        y = drive - (a[0] * y1 + a[1] * y2 + a[2] * y3 + a[3] * y4)
        if k >= settled and (y <= 0.0 or (k > settled and y < y1)):
            return False
        y4, y3, y2, y1 = y3, y2, y1, y
    return True
