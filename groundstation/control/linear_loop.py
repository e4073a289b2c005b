"""The direct loop: a PID whose output is u' itself, on a linear model of one axis.

This is the loop on which the thesis's printed gains act (u' in (rev/s)^2 per rad); it has no
motors, no battery and no limits. The other loops are in ``thesis_loop`` and ``firmware_loop``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.control.margins import LoopResponse, Margins
from groundstation.control.metrics import StepMetrics, step_metrics
from groundstation.control.pid import PidGains
from groundstation.dynamics.model import ArxAxis, Model, angle_polynomial
from groundstation.dynamics.sensors import delay_of_model
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

GRID = 1500
"""Frequencies of a loop's response, logarithmic from 0.05 rad/s up to half the sampling rate."""
SEARCH_GRID = 240
LONGEST_DELAY = 200


@dataclass(frozen=True, slots=True)
class DirectResponse:
    """One axis's answer to a reference: y (k,) rad, u (k,) in (rev/s)^2."""

    y: Array
    u: Array
    stable: bool


def axis_plant(model: Model, axis: str, delay: int | None = None) -> ArxAxis:
    """The linear model of an axis from u' in (rev/s)^2 to its angle in rad.

    The model's ARX polynomials where it has them (those of rates integrated), otherwise its grey
    box, a double integrator c / s^2 under a held input (thesis eq. 7.12-7.14) with the dead time in
    whole samples. u' of a row of fitted polynomials acted before the row, what a loop sets at it
    acts after it: one row more.
    delay: samples instead of the model's own.

    Raises BadInputError for an unknown axis or a delay that is not 0..200 samples.
    """
    if axis not in AXES:
        raise BadInputError(f"axis {axis!r}: there are {', '.join(AXES)}")
    if model.arx is not None and axis in model.arx:
        plant = angle_polynomial(model, axis)
        plant = msgspec.structs.replace(plant, nk=plant.nk + (1 if "arx" in model.fit else 0))
    elif model.body is not None:
        c = (model.body.c0, model.body.c1, model.body.c2)[AXES.index(axis)]
        ts = SAMPLE_PERIOD_S
        late = delay_of_model(model)
        b = c * ts * ts / 2
        plant = ArxAxis(2, 2, 1 + round(late / ts), (-2.0, 1.0), (b, b), ts)
    else:
        raise BadInputError(f"the model has no {axis} axis: fit a body or an ARX model of it")
    nk = plant.nk if delay is None else delay
    if not 0 <= nk <= LONGEST_DELAY:
        raise BadInputError(f"delay of {nk} samples: must be 0..{LONGEST_DELAY}")
    return ArxAxis(plant.na, plant.nb, nk, plant.a, plant.b, plant.ts)


def run_direct(plant: ArxAxis, gains: PidGains, reference: ArrayLike) -> DirectResponse:
    """Close the loop around an axis and follow a reference (k,) in rad."""
    from groundstation.control.linear_loop_kernels import direct_run

    wanted = np.ascontiguousarray(reference, np.float64)
    y, u = np.empty_like(wanted), np.empty_like(wanted)
    direct_run(
        np.array(plant.a),
        np.array(plant.b),
        plant.nk,
        np.array(gains.as_tuple()),
        plant.ts,
        wanted,
        y,
        u,
    )
    return DirectResponse(y, u, is_stable(plant, gains))


def step_direct(plant: ArxAxis, gains: PidGains, seconds: float = 1.0) -> StepMetrics:
    """Metrics of the unit step over a window."""
    response = run_direct(plant, gains, np.ones(round(seconds / plant.ts)))
    return step_metrics(response.y, plant.ts)


def is_stable(plant: ArxAxis, gains: PidGains, delay: int | None = None) -> bool:
    """Whether every pole of the closed loop lies inside the unit circle (Jury's test)."""
    from groundstation.control.linear_loop_kernels import characteristic, inside_unit_circle

    nk = plant.nk if delay is None else delay
    polynomial = np.empty(nk + plant.na + plant.nb + 4)
    size = characteristic(
        np.array(plant.a),
        np.array(plant.b),
        nk,
        np.array(gains.as_tuple()),
        plant.ts,
        polynomial,
    )
    return bool(inside_unit_circle(polynomial, size))


def most_delay(plant: ArxAxis, gains: PidGains) -> int | None:
    """The largest delay in samples up to which the loop is stable; None if it never is."""
    stable = None
    for delay in range(LONGEST_DELAY + 1):
        if not is_stable(plant, gains, delay):
            break
        stable = delay
    return stable


def direct_margins(plant: ArxAxis, gains: PidGains) -> Margins:
    """Margins of the loop broken at the plant's input; meaningful where it is stable."""
    return direct_loop(plant, gains).margins


def direct_loop(plant: ArxAxis, gains: PidGains) -> LoopResponse:
    """The loop broken at the plant's input."""
    omega = grid(plant.ts)
    z = np.exp(1j * omega * plant.ts)
    return LoopResponse(omega, frequency_response(plant, z) * controller(gains, z, plant.ts))


def controller(
    gains: PidGains, z: NDArray[np.complex128], period_s: float
) -> NDArray[np.complex128]:
    """The thesis's PID at points z of the unit circle."""
    kp, ki, kd = gains.as_tuple()
    return kp + ki * period_s / (z - 1) + kd / period_s * (1 - 1 / z)


def grid(period_s: float, points: int = GRID) -> Array:
    """Frequencies in rad/s, logarithmic, up to half the sampling rate."""
    return np.geomspace(0.05, math.pi / period_s, points)


def frequency_response(plant: ArxAxis, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """The plant at points z of the unit circle."""
    import control

    top = plant.nk + max(plant.na, plant.nb - 1)
    numerator = np.zeros(top + 1)
    numerator[plant.nk : plant.nk + plant.nb] = plant.b
    denominator = np.zeros(top + 1)
    denominator[: plant.na + 1] = (1.0, *plant.a)
    system = control.tf(numerator, denominator, plant.ts)
    return np.asarray(system(z), np.complex128)


class DirectJudge:
    """Judges many gains at once on a plant.

    Columns of the result: see ``COLUMNS``. What is unstable, or would be with ``spare_s`` more
    delay, is infinite throughout.
    """

    COLUMNS = (
        "rms",
        "overshoot_pct",
        "settling_s",
        "steady_state_error",
        "sensitivity",
        "effort",
        "compliance",
    )
    """The last, how far a push moves the craft, is not judged on this loop: zero."""

    def __init__(self, plant: ArxAxis, seconds: float, spare_s: float = 0.0) -> None:
        self._plant = plant
        self._reference = np.ones(round(seconds / plant.ts))
        self._spare = math.ceil(spare_s / plant.ts - 1e-9)
        self._z = np.exp(1j * grid(plant.ts, SEARCH_GRID) * plant.ts)
        self._response = frequency_response(plant, self._z)

    def __call__(self, candidates: Array) -> Array:
        """Gains (m, 3) kp, ki, kd to judgements (m, 7)."""
        from groundstation.control.linear_loop_kernels import judge_many

        plant, found = self._plant, np.zeros((len(candidates), len(self.COLUMNS)))
        judge_many(
            np.array(plant.a),
            np.array(plant.b),
            plant.nk,
            self._spare,
            self._response,
            self._z,
            np.ascontiguousarray(candidates),
            plant.ts,
            self._reference,
            found,
        )
        found[:, 2] = np.where(np.isnan(found[:, 2]), np.inf, found[:, 2])
        found[:, 3] = np.abs(found[:, 3])
        return found
