"""Gains for the firmware's loops: designed axis by axis, tried on what the fit is unsure of."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import msgspec
import numpy as np

from groundstation.control.design import (
    EFFORT,
    OFFSET,
    OVERSHOOT,
    SENSITIVITY,
    Design,
    Limits,
    closest,
    optimise,
    reasons,
)
from groundstation.control.firmware_loop import (
    GAIN_MOST,
    SUPPLY_MV,
    UNUSABLE,
    YIELDING,
    CascadeJudge,
    cascade_margins,
)
from groundstation.control.firmwares import Release, firmware_of_vehicle
from groundstation.control.margins import Margins
from groundstation.control.plant import Plant, plant_of_model
from groundstation.control.search import Budget
from groundstation.control.uncertainty import corners, draws, estimates_of, require_certain
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.telemetry.arrays import Array

WINDOW_S = 1.5
LOW: dict[Release, dict[str, tuple[float, ...]]] = {
    "2014": {"roll": (0.5, 0.2, 0.05, 0.002), "yaw": (1.0, 1.0)},
    "2.x": {"roll": (10.0, 1.0, 0.02, 0.5, 0.05), "yaw": (10.0, 0.5, 0.5, 0.05)},
}
HIGH: dict[Release, dict[str, tuple[float, ...]]] = {
    "2014": {"roll": (300.0, 60.0, 100.0, 10.0), "yaw": (GAIN_MOST, GAIN_MOST)},
    "2.x": {
        "roll": (GAIN_MOST, GAIN_MOST, 20.0, 60.0, 60.0),
        "yaw": (GAIN_MOST, 300.0, 40.0, 40.0),
    },
}
"""Where gains are searched, in the order of ``Firmware.gain_names``; pitch as roll."""
MOST_EFFORT = 0.15
"""Largest step of a motor, as a share of full PWM: what hover leaves to either side, less a
reserve for the height."""
AS_STIFF = 1.0 + 1e-6
"""As the stock gains, but for rounding."""
OVERSHOOT_MORE = 2.5
"""Points that gains may overshoot more than the stock ones by the model: half of what is written
(``learn``), for a flight is off by as much again."""
DESIGN_BAND = 0.035
"""Responses that settle only just within the 5 % are not looked for: noise would unsettle them."""
BUDGET = Budget(first=250, population=24, generations=36)
DRAWS = 1000


@dataclass(frozen=True, slots=True)
class AxisDesign:
    """Gains of one axis by the firmware's names, with what they do on the nominal model.

    before: the judgement of the stock gains by what judged the design (inf where they are
    unstable), stock_margins theirs in any case. reasons: one line for each gain.
    """

    axis: str
    gains: dict[str, float]
    design: Design
    before: Array
    nominal: Array
    margins: Margins
    stock_margins: Margins
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Robustness:
    """Judgements (n, 7) of a design on n drawn models, per axis; stable: how many stayed so."""

    drawn: int
    stable: dict[str, int]
    judgements: dict[str, Array]


def cascade_limits(sensitivity: float = 2.0, delay_s: float = 0.002) -> Limits:
    """The limits of a design for the firmware."""
    return Limits(sensitivity=sensitivity, delay_s=delay_s, effort=MOST_EFFORT, yielding=YIELDING)


def design_cascade(
    model: Model,
    axes: Sequence[str],
    limits: Limits,
    seed: int = 0,
    supply_mv: float = SUPPLY_MV,
    budget: Budget = BUDGET,
    progress: Callable[[str, float], None] = lambda axis, share: None,
    release: str | None = None,
) -> list[AxisDesign]:
    """Gains for each axis of a fitted model, on every core.

    A design must keep its limits on the model and two standard errors away from it
    (``uncertainty.corners``). release: of the firmware, None: the vehicle's.

    Raises BadInputError where the model is too uncertain, or no gains keep the limits.
    """
    require_certain(model, axes)

    def one(axis: str) -> AxisDesign:
        plants, judge, low, high, stock = _searched(model, axis, limits, supply_mv, release)
        design = optimise(
            judge, low, high, limits, seed, budget, progress=lambda s: progress(axis, s)
        )
        gains = {n: _rounded(v) for n, v in zip(stock, design.gains, strict=True)}
        alone = CascadeJudge(plants[:1], axis, WINDOW_S, 0.0, supply_mv)
        nominal = alone(np.array([list(gains.values())]))[0]
        return AxisDesign(
            axis,
            gains,
            design,
            judge(np.array([list(stock.values())]))[0],
            nominal,
            cascade_margins(plants[0], gains, axis, supply_mv),
            cascade_margins(plants[0], stock, axis, supply_mv),
            reasons(alone, gains, {name: gain_meaning(name)[1] for name in gains}, limits),
        )

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(one, axes))


def closest_cascade(
    model: Model,
    axis: str,
    limits: Limits,
    seed: int = 0,
    supply_mv: float = SUPPLY_MV,
    budget: Budget = BUDGET,
    release: str | None = None,
) -> tuple[dict[str, float], Array, Array]:
    """Gains of an axis that follow a step the closest within the limits; their judgement, and that
    of the stock gains that it begins with.

    They keep the limits as ``design_cascade``'s do, with those that the stock gains set: where
    these are more sensitive than the limit, or ask more of the motors, so may the gains be; a push
    that lasts moves the craft no further than with them, a fast one twice as far (``CascadeJudge``,
    beside); they overshoot ``OVERSHOOT_MORE`` points more at most.

    Raises BadInputError where the model is too uncertain, or no gains keep the limits.
    """
    _, judge, low, high, names = _searched(
        model, axis, limits, supply_mv, release, unusable=math.inf, beside_stock=True
    )
    stock = np.array([list(names.values())])
    before = judge(stock)[0]
    if np.isfinite(before[SENSITIVITY]):
        limits = msgspec.structs.replace(
            limits,
            sensitivity=max(limits.sensitivity, float(before[SENSITIVITY])),
            effort=max(limits.effort, float(before[EFFORT])),
            offset=max(limits.offset, float(before[OFFSET])),
            compliance=AS_STIFF,
            overshoot=float(before[OVERSHOOT]) + OVERSHOOT_MORE,
        )
    start = np.clip(stock, low, high)
    gains, judged = closest(judge, low, high, limits, start, seed, budget)
    return {n: _rounded(v) for n, v in zip(names, gains, strict=True)}, judged, before


def _searched(
    model: Model,
    axis: str,
    limits: Limits,
    supply_mv: float,
    release: str | None,
    unusable: float = UNUSABLE,
    beside_stock: bool = False,
) -> tuple[list[Plant], CascadeJudge, Array, Array, dict[str, float]]:
    """Plants of a model (the nominal one first), their judge, where gains are searched, (d,) each,
    and the stock gains. Raises BadInputError where the model is too uncertain."""
    require_certain(model, (axis,))
    firmware = firmware_of_vehicle(model_vehicle(model), release)
    plants = [plant_of_model(other, release=release) for other in corners(model, axis)]
    stock = {name: firmware.stock[name] for name in firmware.gain_names(axis)}
    beside = stock if beside_stock else None
    judge = CascadeJudge(
        plants, axis, WINDOW_S, limits.delay_s, supply_mv, DESIGN_BAND, unusable, beside
    )
    kind = "yaw" if axis == "yaw" else "roll"
    low, high = np.array(LOW[firmware.name][kind]), np.array(HIGH[firmware.name][kind])
    return plants, judge, low, high, stock


def robustness(
    model: Model,
    gains: Mapping[str, float],
    axes: Sequence[str],
    count: int = DRAWS,
    seed: int = 0,
    supply_mv: float = SUPPLY_MV,
    release: str | None = None,
) -> Robustness | None:
    """How gains do on models drawn from the fit's covariance; None where it carries none."""
    if not estimates_of(model):
        return None
    plants = [plant_of_model(other, release=release) for other in draws(model, count, seed)]
    names = firmware_of_vehicle(model_vehicle(model), release).gain_names
    cores = os.cpu_count() or 1
    judgements = {}
    with ThreadPoolExecutor(cores) as pool:
        for axis in axes:
            values = np.array([[gains[name] for name in names(axis)]])
            slices = [plants[i::cores] for i in range(cores)]

            def judged(part: Sequence[Plant], axis: str = axis, values: Array = values) -> Array:
                return np.vstack(
                    [CascadeJudge([p], axis, WINDOW_S, 0.0, supply_mv)(values) for p in part]
                )

            judgements[axis] = np.vstack(list(pool.map(judged, slices)))
    stable = {axis: int(np.isfinite(table[:, 0]).sum()) for axis, table in judgements.items()}
    return Robustness(count, stable, judgements)


def _rounded(value: float) -> float:
    """To four significant digits, which is more than a gain means."""
    return float(f"{value:.4g}")


PURPOSE = {
    ("pid_rate", "kp"): "damps the rate against the motors' lag",
    ("pid_rate", "kd"): "turns the loop forward against the motors' lag and the filters'",
    ("pid_rate", "ki"): "removes lasting rate errors, such as trim",
    ("pid_attitude", "kp"): "sets how fast the angle follows",
    ("pid_attitude", "ki"): "removes the lean of the attitude filter and trim",
    ("pid_attitude", "kd"): "pushes at once when the setpoint moves, ahead of the motors' lag",
}


_UNITS = {
    ("pid_rate", "kp"): "PWM counts per deg/s",
    ("pid_rate", "ki"): "PWM counts per deg",
    ("pid_rate", "kd"): "PWM counts per deg/s²",
    ("pid_attitude", "kp"): "deg/s per deg",
    ("pid_attitude", "ki"): "deg/s per deg s",
    ("pid_attitude", "kd"): "deg/s per deg/s",
}


def gain_meaning(name: str) -> tuple[str, str]:
    """(unit, meaning) of one of the firmware's gains."""
    which = name.split(".")[0], name.split("_")[-1]
    return _UNITS[which], PURPOSE[which]
