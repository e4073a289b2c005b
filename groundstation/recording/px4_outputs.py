"""Which of a PX4 driver's outputs are motors 1 to 4, and what stands for none and full duty.

An output is what its driver was told: a pulse, a DShot value, an ESC's count on a bus, a speed of a
simulated rotor. Functions and ends of the ranges are parameters of the driver's prefix; without
them, the numbers decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.recording.motor_columns import MOVES, changes, too_many
from groundstation.telemetry.arrays import Array

Parameters = Mapping[str, float]

MOTOR_1, MOTORS = 101, 12
"""Of an output's function that is motor 1 (PWM_MAIN_FUNCn), and how many such functions follow."""
PULSES, ONE_SHOT_US, DSHOT = (1000.0, 2000.0), (125.0, 250.0), (0.0, 1999.0)
"""Ends of the drivers' ranges: pulses where no parameter says others, OneShot125, PX4's DShot."""
ESC, SPEED = (0.0, 8191.0), (0.0, 1000.0)
"""The same of UAVCAN's ESCs, and of Gazebo's rotors, rad/s."""
DRIVERS = {"PWM_MAIN": PULSES, "PWM_AUX": PULSES, "UAVCAN_EC": ESC, "SIM_GZ_EC": SPEED}
WITH_FUNCTIONS = (*DRIVERS, "HIL_ACT")
LEAST_PWM_US, MOST_PWM_US = 800.0, 2200.0
"""Other values are of another protocol than pulses."""
DSHOT_TIMER = -2.0
"""Largest PWM_MAIN_TIMn that is DShot: -5 to -2 are its rates, -1 is OneShot, others pulses' Hz."""
BELOW_LOW, ABOVE_HIGH = 0.8, 1.1
"""Of a range's ends, beyond which outputs are not in it: disarmed ones are below by a tenth."""
NOT_KNOWN = (
    "the range of the motors' outputs is not known: up to {:.4g}, which {} would be as well; the"
    " parameters do not say, and the duty may be wrong by a factor"
)


@dataclass(frozen=True, slots=True)
class Outputs:
    """places: of motors 1 to 4 among an instance's outputs. prefix: of the driver's parameters,
    where their functions say the places. crowd: why they are no quadrotor's, or empty."""

    places: list[int]
    prefix: str = ""
    crowd: str = ""


@dataclass(frozen=True, slots=True)
class Range:
    """low, high: what stands for no and full duty, of each motor or all. what: in words. open: what
    is not known of it."""

    low: Array | float
    high: Array | float
    what: str
    open: str = ""


def motors_among(values: Array, parameters: Parameters) -> Outputs:
    """By the functions that the parameters give outputs (n, k), as far as these move; else the
    four that move, the first of them; where fewer do, the first four."""
    count = changes(values)
    for prefix in WITH_FUNCTIONS:
        given = {
            int(parameters.get(f"{prefix}_FUNC{k + 1}", 0)) - MOTOR_1: k
            for k in range(values.shape[1])
        }
        places = [given[motor] for motor in range(4) if motor in given]
        if len(places) == 4 and count[places].min() > 0:
            more = [given[motor] for motor in range(4, MOTORS) if motor in given]
            return Outputs(places, prefix, crowd_of(count, places, more, "output"))
    moving = np.flatnonzero(count > MOVES * float(np.median(np.sort(count)[-4:])))
    places = [int(k) for k in moving[:4]] if len(moving) >= 4 else [0, 1, 2, 3]
    others = [k for k in range(len(count)) if k not in places]
    return Outputs(places, crowd=crowd_of(count, places, others, "output"))


def crowd_of(
    count: NDArray[np.intp], places: Sequence[int], others: Sequence[int], field: str
) -> str:
    """Why more than the motors at these places move, by how often each output changes, or empty."""
    names = [f"{field}[{k}]" for k in others]
    return too_many(count[list(places)], count[list(others)], names)


def range_of(given: Array, parameters: Parameters, found: Outputs) -> Range | None:
    """What the motors' outputs (n, 4) mean; None where nothing that is known has such numbers."""
    turning = given[np.isfinite(given) & (given > 0.0)]
    least, most = (float(turning.min()), float(turning.max())) if len(turning) else PULSES
    timers = [
        value
        for prefix in ([found.prefix] if found.prefix else ["PWM_MAIN", "PWM_AUX"])
        for k in range(8)
        if (value := parameters.get(f"{prefix}_TIM{k}")) is not None
    ]
    digital = any(one <= DSHOT_TIMER for one in timers) or parameters.get("DSHOT_CONFIG", 0.0) > 0.0
    bus = found.prefix and not found.prefix.startswith("PWM")
    if digital and not bus and 1.0 < most <= DSHOT[1]:
        return Range(*DSHOT, "DShot")
    told = _told(parameters, found, least, most)
    return told if told is not None else _by_numbers(parameters, found, least, most)


def _told(parameters: Parameters, found: Outputs, least: float, most: float) -> Range | None:
    """By the ends that the parameters of the driver say, where the numbers lie between them."""
    prefix = found.prefix or "PWM_MAIN"
    if prefix not in DRIVERS:
        return None
    ends = []
    for end, usual in zip(("MIN", "MAX"), DRIVERS[prefix], strict=True):
        shared = parameters.get(f"{prefix}_{end}", usual)
        if prefix == "PWM_MAIN":
            shared = parameters.get(f"PWM_{end}", shared)
        own = [parameters.get(f"{prefix}_{end}{k + 1}", -1.0) for k in found.places]
        ends.append(np.array([one if one >= 0.0 else shared for one in own]))
    low, high = ends
    if not (high > low).all():
        low, high = (np.full(4, end) for end in DRIVERS[prefix])
    if least < BELOW_LOW * low.min() or most > ABOVE_HIGH * high.max():
        return None
    if not found.prefix and not (least >= LEAST_PWM_US and most <= MOST_PWM_US):
        return None
    unit = {"UAVCAN_EC": "an ESC's counts", "SIM_GZ_EC": "rotor speeds"}.get(prefix, "pulses")
    of = " us" if unit == "pulses" else " rad/s" if unit == "rotor speeds" else ""
    return Range(low, high, f"{unit} of {low[0]:g} to {high[0]:g}{of}")


def _by_numbers(parameters: Parameters, found: Outputs, least: float, most: float) -> Range | None:
    """By their least and most while the motors turn."""
    if most <= 1.0:
        return Range(0.0, 1.0, "fractions")
    if most <= ONE_SHOT_US[1] and least >= ONE_SHOT_US[0] - 5.0:
        return Range(*ONE_SHOT_US, "OneShot125")
    if least >= LEAST_PWM_US and most <= MOST_PWM_US:
        return Range(*PULSES, "pulses of 1000 to 2000 us")
    if most <= SPEED[1]:
        if any(one.startswith("SIM_GZ_EC_FUNC") for one in parameters) and not found.prefix:
            return Range(*SPEED, "rotor speeds of 0 to 1000 rad/s")
        return Range(*DSHOT, "DShot", NOT_KNOWN.format(most, "a simulation's 0 to 1000"))
    if most <= DSHOT[1]:
        return Range(*DSHOT, "DShot")
    if most <= ESC[1]:
        return Range(*ESC, "an ESC's counts of 0 to 8191")
    return None
