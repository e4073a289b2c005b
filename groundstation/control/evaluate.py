"""Gains on a model, in one of three loops: what a step gives and what margins are left."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from groundstation.control.firmware_loop import (
    STEP_RAD,
    cascade_loop,
    step_response,
)
from groundstation.control.linear_loop import (
    axis_plant,
    direct_loop,
    is_stable,
    most_delay,
    run_direct,
)
from groundstation.control.margins import LoopResponse, Margins
from groundstation.control.metrics import StepMetrics, step_metrics
from groundstation.control.pid import PidGains
from groundstation.control.plant import Plant, plant_of_model
from groundstation.control.thesis_loop import run_whole, whole_loop
from groundstation.dynamics.model import Model
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

Loop = Literal["direct", "whole", "firmware"]
LOOPS: tuple[Loop, ...] = ("direct", "whole", "firmware")
WHOLE_STEP_RAD = 0.2
"""Step of the whole simulation, in which a larger one saturates."""
STEADY_S = 4.0
"""Over so long a window a loop with motors shows whether it calms down."""
STILL = 0.1
"""A response that swings by less than this share of the step at its end is calm."""


@dataclass(frozen=True, slots=True)
class AxisResult:
    """One axis. response: (k,) over the step, one row per 2 ms. step: in rad, yaw of the
    firmware in rad/s. margins: None where the loop is unstable. most_delay: samples up to which
    it is stable, only on the direct loop. loop: its frequency response, stable or not."""

    axis: str
    gains: dict[str, float]
    step: float
    metrics: StepMetrics
    stable: bool
    margins: Margins | None
    response: Array
    loop: LoopResponse
    most_delay: int | None = None

    def as_dict(self) -> dict[str, Any]:
        """The design's keys for ``pid evaluate --json``, and more."""
        margins = self.margins.as_dict() if self.margins is not None else {}
        return {
            **self.metrics.as_dict(),
            "max_sensitivity": margins.get("max_sensitivity"),
            "delay_margin_s": margins.get("delay_s"),
            "gain_up": margins.get("gain_up"),
            "gain_down": margins.get("gain_down"),
            "phase_margin_deg": margins.get("phase_deg"),
            "stable": self.stable,
            "most_delay_samples": self.most_delay,
            "step": self.step,
            "gains": self.gains,
        }


def evaluate(
    model: Model,
    gains: Mapping[str, PidGains] | Mapping[str, float],
    loop: Loop,
    seconds: float = 1.0,
    delay: int | None = None,
    release: str | None = None,
) -> list[AxisResult]:
    """A step on each axis for which there are gains, one axis at a time.

    gains: by axis for ``direct`` (u' per rad) and ``whole`` (PWM counts per rad), by parameter
    for ``firmware``. delay: samples instead of the model's, not for ``firmware``. release: whose
    loops ``firmware`` is, None: the vehicle's; they fly the model's body, the other two its
    polynomials where it has them.

    Raises BadInputError for gains of the other form, or a model that the loop cannot use.
    """
    by_axis = {name: g for name, g in gains.items() if isinstance(g, PidGains)}
    if loop == "firmware":
        if by_axis:
            raise BadInputError("gains by axis are the thesis's form: --loop direct or whole")
        if delay is not None:
            raise BadInputError("--delay: the firmware's loop has the model's dead time")
        values = {name: g for name, g in gains.items() if not isinstance(g, PidGains)}
        plant = plant_of_model(model, release=release)
        return [_firmware(plant, values, axis, seconds) for axis in AXES]
    if not by_axis:
        raise BadInputError(f"--loop {loop} needs gains by axis, [roll] kp = ...")
    if loop == "direct":
        return [_direct(model, g, axis, seconds, delay) for axis, g in by_axis.items()]
    return _whole(model, by_axis, seconds, delay)


def _direct(
    model: Model, gains: PidGains, axis: str, seconds: float, delay: int | None
) -> AxisResult:
    plant = axis_plant(model, axis, delay)
    with np.errstate(over="ignore", invalid="ignore"):
        y = run_direct(plant, gains, np.ones(round(seconds / plant.ts))).y
    stable, loop = is_stable(plant, gains), direct_loop(plant, gains)
    return AxisResult(
        axis,
        dict(zip(("kp", "ki", "kd"), gains.as_tuple(), strict=True)),
        1.0,
        step_metrics(y, plant.ts),
        stable,
        loop.margins if stable else None,
        y,
        loop,
        most_delay(plant, gains),
    )


def _whole(
    model: Model, gains: Mapping[str, PidGains], seconds: float, delay: int | None
) -> list[AxisResult]:
    found = []
    for axis, one in gains.items():
        index = AXES.index(axis)
        reference = np.zeros((round(max(seconds, STEADY_S) / SAMPLE_PERIOD_S), 3))
        reference[:, index] = WHOLE_STEP_RAD
        others = [gains.get(name, PidGains(0.0)) for name in AXES]
        long = run_whole(model, others, reference, delay=delay).angles[:, index]
        y = long[: round(seconds / SAMPLE_PERIOD_S)]
        stable = calms(long / WHOLE_STEP_RAD)
        loop = whole_loop(model, one, axis, delay)
        found.append(
            AxisResult(
                axis,
                dict(zip(("kp", "ki", "kd"), one.as_tuple(), strict=True)),
                WHOLE_STEP_RAD,
                step_metrics(y, SAMPLE_PERIOD_S, WHOLE_STEP_RAD),
                stable,
                loop.margins if stable else None,
                y / WHOLE_STEP_RAD,
                loop,
            )
        )
    return found


def _firmware(plant: Plant, gains: Mapping[str, float], axis: str, seconds: float) -> AxisResult:
    step = STEP_RAD[axis]
    y = step_response(plant, gains, axis, seconds)
    loop = cascade_loop(plant, gains, axis)
    stable = calms(step_response(plant, gains, axis, max(seconds, STEADY_S)))
    return AxisResult(
        axis,
        {n: gains.get(n, plant.firmware.stock[n]) for n in plant.firmware.gain_names(axis)},
        step,
        step_metrics(y * step, SAMPLE_PERIOD_S, step),
        stable,
        loop.margins if stable else None,
        y,
        loop,
    )


def calms(response: Array) -> bool:
    """Whether a response over its step calms down: its last quarter swings little, or less than
    the one before, and about the reference."""
    parts: Sequence[Array] = np.array_split(response, 4)
    swings = [float(np.ptp(part)) for part in parts]
    if not math.isfinite(swings[3]):
        return False
    return swings[3] < STILL or (swings[3] < 0.8 * swings[2] and swings[3] < 1.0)
