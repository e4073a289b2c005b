"""The craft of ``simulate`` in a compiled closed loop: one period of it, and of polynomials."""

from __future__ import annotations

from typing import Any

from groundstation.compiled import spliced
from groundstation.dynamics.kernels import (
    ALL,
    armature,
    body_slope,
    craft_step,
    motor_slopes,
    normalise,
)

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
