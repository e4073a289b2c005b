"""The compiled closed loop of the thesis's Figure 8.10, with the craft of ``simulate``."""

from __future__ import annotations

from typing import Any

import numpy as np

from groundstation.compiled import kernel
from groundstation.control.plant_kernels import ROTOR, answer, move
from groundstation.dynamics import sensing as quaternion
from groundstation.dynamics.kernels import physics
from groundstation.dynamics.vehicle import PWM_FULL


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
