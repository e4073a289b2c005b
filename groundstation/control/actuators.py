"""What motors can follow: gains of the direct loop, in which u' is free, beside the motors' own."""

from __future__ import annotations

import math

import numpy as np

from groundstation.control.evaluate import STEADY_S, WHOLE_STEP_RAD, calms
from groundstation.control.gain_conversion import scaled
from groundstation.control.linear_loop import axis_plant, run_direct
from groundstation.control.pid import PidGains
from groundstation.control.thesis_loop import (
    SUPPLY_MV,
    counts_per_control,
    motors_and_body,
    run_whole,
)
from groundstation.dynamics.model import Model
from groundstation.telemetry.arrays import AXES
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

JUDGED_S = 1.5
MORE = 2.0
"""Times the RMS error of the direct loop that the motors may make of it."""


def most_control(model: Model, axis: str, supply_mv: float = SUPPLY_MV) -> float:
    """The largest u' in (rev/s)^2 that the rotors give around hover with the thrust kept."""
    plant = motors_and_body(model)
    hover, motor = plant.hover_rev_s, model.motor
    # a0 u = a1 n + a2 n^2 at rest (thesis eq. 3.82)
    root = math.sqrt(motor.a1**2 + 4 * motor.a2 * motor.a0 * supply_mv)
    full = 2 * motor.a0 * supply_mv / (motor.a1 + root)
    either_way = min(full**2 - hover**2, hover**2)
    return float(np.abs(plant.mixer[AXES.index(axis)]).sum() * max(either_way, 0.0))


def reason_not_followed(
    model: Model,
    gains: PidGains,
    axis: str,
    delay: int | None = None,
    supply_mv: float = SUPPLY_MV,
) -> str:
    """Why the motors of a model cannot follow gains on u'; empty where they can.

    The gains are flown through a step of 0.2 rad, on the direct loop and, as PWM counts, on the
    whole one: there they must calm down, and not miss the reference by much more.
    """
    index, rows = AXES.index(axis), round(STEADY_S / SAMPLE_PERIOD_S)
    counts = float(counts_per_control(model, supply_mv)[index])
    three = [scaled(gains, counts) if one == axis else PidGains(0.0) for one in AXES]
    reference = np.zeros((rows, 3))
    reference[:, index] = WHOLE_STEP_RAD
    flown = run_whole(model, three, reference, delay=delay, supply_mv=supply_mv)
    behind = flown.angles[:, index] / WHOLE_STEP_RAD
    plant = axis_plant(model, axis, delay)
    free = run_direct(plant, gains, np.ones(round(STEADY_S / plant.ts)))
    missed, promised = (
        float(np.sqrt(np.mean((1.0 - y[: round(JUDGED_S / period_s)]) ** 2)))
        for y, period_s in ((behind, SAMPLE_PERIOD_S), (free.y, plant.ts))
    )
    calm = calms(behind)
    if calm and missed <= MORE * promised:
        return ""
    asked = (gains.kp + gains.kd / SAMPLE_PERIOD_S) * WHOLE_STEP_RAD  # in the step's first row
    most = most_control(model, axis, supply_mv)
    lag = 1.0 / (model.motor.a1 + 2 * model.motor.a2 * motors_and_body(model).hover_rev_s)
    return (
        f"{axis}: kp {gains.kp:.3g}, kd {gains.kd:.3g} ask u' = {asked:.2g} (rev/s)^2 for a step of"
        f" {WHOLE_STEP_RAD:g} rad; the rotors give {most:.2g} around hover and follow with a lag of"
        f" {1e3 * lag:.0f} ms, behind which "
        + (
            f"the angle misses the step by {missed:.2f} of it instead of {promised:.2f} (RMS over"
            f" {JUDGED_S:g} s)"
            if calm
            else "the loop is unstable"
        )
    )
