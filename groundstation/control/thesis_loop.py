"""The thesis's whole simulation (Figure 8.10): its controllers with everything between them and
the angles.

Reference, PIDs, their saturation at +-4096 PWM counts, power distribution (8.3), output stage
with the battery (8.2.6), four motors (3.82), mixer (7.19), body, measurement delay. Gains are
PWM counts per rad here. The printed gains are not: they act on u' in (rev/s)^2, on the loop of
``linear_loop``; a saturation at +-4096 does not go with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.control.firmware_loop import hold_response, rate_per_pwm
from groundstation.control.firmwares import FULL, RELEASE_2014
from groundstation.control.linear_loop import axis_plant, controller, frequency_response, grid
from groundstation.control.margins import LoopResponse
from groundstation.control.pid import PidGains
from groundstation.control.plant import Plant, motors_of_model, plant_of_model
from groundstation.dynamics.model import Model, angle_polynomial, stacked
from groundstation.dynamics.vehicle import PWM_FULL
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

SUPPLY_MV = 3700.0
SAME_PERIOD = 0.01
"""Share by which two periods may differ and be one."""


@dataclass(frozen=True, slots=True)
class WholeResponse:
    """angles (k, 3) rad as the controller hears them, controls (k, 3) and pwm (k, 4) in counts."""

    angles: Array
    controls: Array
    pwm: Array


def run_whole(
    model: Model,
    gains: Sequence[PidGains],
    reference: ArrayLike,
    *,
    delay: int | None = None,
    supply_mv: ArrayLike = SUPPLY_MV,
) -> WholeResponse:
    """Follow a reference (k, 3) in rad, one row per 2 ms, from a level hover.

    The model's polynomials turn the craft where it has them in the loop's period, otherwise its
    rigid body with its effects. gains: for roll, pitch, yaw. delay: samples of measurement delay;
    by default what the model says (the polynomials' nk, or its dead time).

    Raises BadInputError for a model without a body, or with polynomials of some axes only.
    """
    from groundstation.control.thesis_loop_kernel import whole_run

    if model.arx is not None and any(axis not in model.arx for axis in AXES):
        raise BadInputError("the model has no ARX polynomials for roll, pitch and yaw")
    model = _of_the_loop(model)
    plant = motors_and_body(model)
    a, b, nk = np.zeros((3, 1)), np.zeros((3, 1)), np.zeros(3, np.int64)
    if model.arx is not None:
        a, b, nk = stacked([angle_polynomial(model, axis) for axis in AXES])
        nk = np.maximum(nk, 1) if delay is None else np.full(3, delay)  # speeds act after a row
    wanted = np.ascontiguousarray(reference, np.float64)
    rows = len(wanted)
    # new arrays: numba compiles the kernel anew, half a minute, for one that is read-only
    supply = np.full(rows, supply_mv, np.float64)
    lift = np.array(plant.hover_duty(supply) * PWM_FULL)
    own = round(float(plant.sensor[0]["delay"]) / SAMPLE_PERIOD_S)
    angles, controls, pwm = np.zeros((rows, 3)), np.zeros((rows, 3)), np.zeros((rows, 4))
    whole_run(
        plant.craft[0],
        plant.mixer,
        plant.start,
        a,
        b,
        nk,
        model.arx is not None,
        np.array([one.as_tuple() for one in gains]),
        lift,
        supply,
        wanted,
        SAMPLE_PERIOD_S,
        own if delay is None else delay,
        angles,
        controls,
        pwm,
    )
    return WholeResponse(angles, controls, pwm)


def counts_per_control(model: Model, supply_mv: float = SUPPLY_MV) -> Array:
    """PWM counts that change u' by 1 (rev/s)^2 at hover once the motors have settled, (3,).

    Turns gains of the direct loop into gains of the whole simulation.
    """
    plant, motor = motors_and_body(model), model.motor
    slope = motor.a0 * supply_mv / PWM_FULL / (motor.a1 + 2 * motor.a2 * plant.hover_rev_s)
    return 1.0 / (2 * plant.hover_rev_s * slope * np.array([2.0, 2.0, 4.0]))


def whole_loop(
    model: Model,
    gains: PidGains,
    axis: str,
    delay: int | None = None,
    supply_mv: float = SUPPLY_MV,
) -> LoopResponse:
    """One axis, linear around hover and broken at the controller's output; its margins mean
    something where it is stable."""
    omega = grid(SAMPLE_PERIOD_S)
    z = np.exp(1j * omega * SAMPLE_PERIOD_S)
    driven = counts_response(model, axis, omega, delay, supply_mv)
    return LoopResponse(omega, driven * controller(gains, z, SAMPLE_PERIOD_S))


def counts_response(
    model: Model,
    axis: str,
    omega: Array,
    delay: int | None = None,
    supply_mv: float = SUPPLY_MV,
) -> NDArray[np.complex128]:
    """Angle in rad per PWM count of an axis around hover, motors included, at omega (n,) rad/s.

    The rigid body with its model's damping and rotor torques; of polynomials, the settled motors'
    slope and their lag before them.
    """
    model = _of_the_loop(model)
    if model.arx is None:
        # its controller's output is PWM
        plant = replace(motors_and_body(model), firmware=RELEASE_2014)
        own = round(float(plant.sensor[0]["delay"]) / SAMPLE_PERIOD_S) if delay is None else delay
        s = 1j * omega
        late = hold_response(s, SAMPLE_PERIOD_S) * np.exp(-own * SAMPLE_PERIOD_S * s)
        rate = rate_per_pwm(plant, AXES.index(axis), s, supply_mv)
        return FULL / PWM_FULL * rate / s * late
    polynomials = axis_plant(model, axis, delay)
    pole = model.motor.a1 + 2 * model.motor.a2 * motors_and_body(model).hover_rev_s
    counts = counts_per_control(model, supply_mv)[AXES.index(axis)]
    motor = pole / (1j * omega + pole) / counts
    return frequency_response(polynomials, np.exp(1j * omega * polynomials.ts)) * motor


def motors_and_body(model: Model) -> Plant:
    """What the loop flies beside polynomials: the motors, and the body where the model has one."""
    if model.body is None:
        return motors_of_model(model)
    return plant_of_model(model, fusion=False)


def _of_the_loop(model: Model) -> Model:
    """The model with its polynomials only where they step as the loop does, every 2 ms.

    Raises BadInputError where it has others and no body.
    """
    steps = {one.ts for one in (model.arx or {}).values()}
    if all(abs(ts / SAMPLE_PERIOD_S - 1.0) <= SAME_PERIOD for ts in steps):
        return model
    if model.body is None:
        raise BadInputError(
            f"the ARX polynomials make a step every {1e3 * max(steps):g} ms, the loop every"
            f" {1e3 * SAMPLE_PERIOD_S:g} ms, and the model has no body: --loop direct takes them"
        )
    return msgspec.structs.replace(model, arx=None)
