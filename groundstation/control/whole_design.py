"""Gains for the thesis's whole loop (Figure 8.10): designed with its motors and their limits.

Each candidate is flown: steps on the nonlinear loop, PWM cut off at its ends, motors, mixer and
body; and judged by its linear response around hover. Gains are PWM counts per rad.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.control.design import Design, Limits, direct_bounds, optimise
from groundstation.control.evaluate import WHOLE_STEP_RAD, calms
from groundstation.control.linear_loop import axis_plant, controller, grid
from groundstation.control.margins import LoopResponse
from groundstation.control.metrics import step_metrics
from groundstation.control.pid import AXES, PidGains
from groundstation.control.search import Budget
from groundstation.control.thesis_loop import (
    SUPPLY_MV,
    Body,
    body_of,
    counts_per_control,
    counts_response,
    run_whole,
    whole_loop,
)
from groundstation.control.uncertainty import corners, require_certain
from groundstation.dynamics.arx_period import at_period
from groundstation.dynamics.mixer import PWM_FULL
from groundstation.dynamics.model import Model
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

Array = NDArray[np.float64]

WINDOW_S = {"roll": 1.5, "pitch": 1.5, "yaw": 3.0}
"""Yaw has the weakest torque."""
STEPS_RAD = (0.02, WHOLE_STEP_RAD)
"""Flown both, the worse counts: only a large step's derivative is cut off, and overshoots less."""
YIELDING = 2.0
"""As for the firmware's loops."""
AT_STOPS_S = 0.01
"""Longest time that a step may hold a motor at 0 or at full: a derivative of the error does for a
row or two."""
UNUSABLE = 4.0
"""Maximum sensitivity beyond which a loop is not flown."""
SLOWEST = np.array([1.0, 0.01, 1.0])
QUICKEST = np.array([1500.0, 500.0, 80.0])
"""Where gains are searched over the acceleration of a unit: 1 to 39 rad/s, about the motors'."""
BUDGET = Budget(first=400, population=24, generations=24)
SEARCH_GRID = 200


@dataclass(frozen=True, slots=True)
class WholeDesign:
    """Gains of one axis in PWM counts. nominal: their judgement (7,) on the model itself, loop its
    response, judge: that of the model alone."""

    axis: str
    gains: PidGains
    design: Design
    nominal: Array
    loop: LoopResponse
    judge: WholeJudge


def whole_limits(sensitivity: float = 2.0, delay_s: float = 0.002) -> Limits:
    """The limits of a design for the whole loop; its effort is the time at the motors' stops."""
    return Limits(sensitivity=sensitivity, delay_s=delay_s, effort=AT_STOPS_S, yielding=YIELDING)


def design_whole(
    model: Model,
    axes: Sequence[str],
    limits: Limits,
    seed: int = 0,
    delay: int | None = None,
    supply_mv: float = SUPPLY_MV,
    budget: Budget | None = None,
    progress: Callable[[str, float], None] = lambda axis, share: None,
) -> list[WholeDesign]:
    """A PID for each axis, with everything that lies between it and the angle.

    A model with a body must keep the limits two standard errors away too; polynomials carry no
    covariance that reaches the loop. delay: samples instead of the model's. budget: of the search,
    by default ``BUDGET``.

    Raises BadInputError where the model is too uncertain, or no gains keep the limits.
    """
    if body_of(model) is not Body.ARX:
        require_certain(model, axes)
    model = at_period(model, SAMPLE_PERIOD_S)

    def one(axis: str) -> WholeDesign:
        others = [model] if body_of(model) is Body.ARX else corners(model, axis)
        judge = WholeJudge(others, axis, limits.delay_s, delay, supply_mv)
        counts = counts_per_control(model, supply_mv)[AXES.index(axis)]
        low, _ = direct_bounds(axis_plant(model, axis, delay))
        unit = counts * low / np.array([0.1, 0.01, 0.1])  # counts for an acceleration of 1 rad/s^2
        design = optimise(
            judge, SLOWEST * unit, QUICKEST * unit, limits, seed, budget or BUDGET,
            progress=lambda share: progress(axis, share),
        )  # fmt: skip
        gains = PidGains(*(float(f"{value:.4g}") for value in design.gains))
        alone = WholeJudge([model], axis, 0.0, delay, supply_mv)
        nominal = alone(np.array([gains.as_tuple()]))[0]
        loop = whole_loop(model, gains, axis, body_of(model), delay, supply_mv)
        return WholeDesign(axis, gains, design, nominal, loop, alone)

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(one, axes))


class WholeJudge:
    """Judges gains (m, 3) of one axis, kp, ki, kd in PWM counts.

    models: the first is flown through both ``STEPS_RAD``, of all of them the worst margins and
    compliance count. Columns as ``DirectJudge``. Effort is the time in s that any motor stands at a
    stop; compliance the angle in rad that a push of 1 rad/s^2 makes at most. What is unstable,
    would be with ``spare_s`` more delay, or has a sensitivity beyond ``UNUSABLE`` is infinite
    throughout.
    """

    def __init__(
        self,
        models: Sequence[Model],
        axis: str,
        spare_s: float = 0.0,
        delay: int | None = None,
        supply_mv: float = SUPPLY_MV,
    ) -> None:
        self._models, self._axis, self._delay, self._supply = models, axis, delay, supply_mv
        self._spare = spare_s
        self._omega = grid(SAMPLE_PERIOD_S, SEARCH_GRID)
        self._z = np.exp(1j * self._omega * SAMPLE_PERIOD_S)
        self._body = body_of(models[0])
        self._driven = [
            counts_response(model, axis, self._omega, self._body, delay, supply_mv)
            for model in models
        ]
        self._rows = round(WINDOW_S[axis] / SAMPLE_PERIOD_S)

    def __call__(self, candidates: Array) -> Array:
        """Gains (m, 3) to judgements (m, 7)."""
        return np.array([self._one(PidGains(*map(float, row))) for row in candidates])

    def _one(self, gains: PidGains) -> Array:
        shape = controller(gains, self._z, SAMPLE_PERIOD_S)
        worst = np.zeros(7)
        for driven in self._driven:
            loop = driven * shape
            left = np.abs(1.0 / (1.0 + loop))
            if left.max() > UNUSABLE or _spare_delay(loop, self._omega) < self._spare:
                return np.full(7, np.inf)
            worst[4] = max(worst[4], left.max())
            worst[6] = max(worst[6], float((left / self._omega**2).max()))
        for step in STEPS_RAD:
            flown = self._fly(gains, step)
            if flown is None:
                return np.full(7, np.inf)
            worst[[0, 1, 2, 3, 5]] = np.maximum(worst[[0, 1, 2, 3, 5]], flown)
        return worst

    def _fly(self, gains: PidGains, step: float) -> tuple[float, ...] | None:
        """On the first model: RMS of the step, overshoot in percent, settling in s, offset of the
        step, time at the stops in s; None for a response that does not calm down."""
        reference = np.zeros((self._rows, 3))
        reference[:, AXES.index(self._axis)] = step
        three = [gains if axis == self._axis else PidGains(0.0) for axis in AXES]
        response = run_whole(
            self._models[0],
            three,
            reference,
            self._body,
            delay=self._delay,
            supply_mv=self._supply,
        )
        y = response.angles[:, AXES.index(self._axis)] / step
        if not calms(y):
            return None
        found = step_metrics(y, SAMPLE_PERIOD_S)
        settling = math.inf if found.settling_s is None else found.settling_s
        stopped = ((response.pwm <= 0.0) | (response.pwm >= PWM_FULL)).any(axis=1).sum()
        return (
            found.rms, found.overshoot_pct, settling, abs(found.steady_state_error),
            float(stopped) * SAMPLE_PERIOD_S,
        )  # fmt: skip


def _spare_delay(loop: NDArray[np.complex128], omega: Array) -> float:
    """The smallest delay in s that turns the locus onto -1."""
    size = np.log(np.abs(loop))
    at = np.flatnonzero(size[:-1] * size[1:] < 0.0)
    if not len(at):
        return math.inf
    share = size[at] / (size[at] - size[at + 1])
    phase = np.unwrap(np.angle(loop))
    away = phase[at] + share * (phase[at + 1] - phase[at])
    crossing = omega[at] + share * (omega[at + 1] - omega[at])
    return float((np.mod(away + math.pi, 2 * math.pi) / crossing).min())
