"""What lies between the craft and its telemetry: the effects of sensors and of the supply's report.

Order: rates pass the gyro's low-pass, rates and specific force are turned into the sensor's axes,
biases are added, everything is late by the dead time. Reported angles are the sensor's true
attitude, or, with attitude_filter_lean, those of the Mahony filter in the firmware.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.effects.own import find_effect
from groundstation.dynamics.model import Model
from groundstation.dynamics.rotations import rotation_matrix
from groundstation.errors import BadInputError
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]

SENSORS = np.dtype(
    [
        ("delay", "f8"),  # s
        ("gyro_lag", "f8"),  # s
        ("gyro_bias", "f8", (3,)),  # rad/s
        ("accelerometer_bias", "f8", (3,)),  # m/s^2
        ("mounting", "f8", (3, 3)),  # body <- sensor
        ("rotated", "i8"),
        ("lever", "f8", (3,)),  # m, centre of gravity to sensor
        ("lean", "f8"),  # of the Mahony gains, 0: angles are the truth
    ]
)
MOST_CHANGE = 0.25
"""A supply voltage that is reckoned back from a lagging report stays within this share of it."""


def sensors_of_model(model: Model) -> NDArray[np.void]:
    """A record of ``SENSORS``, shape (1,): an ideal sensor, and what the model's effects change.

    Raises BadInputError for an effect that does not exist or a value that cannot be.
    """
    record = np.zeros(1, SENSORS)
    sensor = record[0]
    sensor["mounting"] = np.eye(3)
    for term in model.effects:
        effect = find_effect(term.name, term.source)
        values = effect.values({name: one.value for name, one in term.parameters.items()})
        numbers = list(values.values())
        if effect.name == "dead_time":
            sensor["delay"] += _not_negative("dead_time", "delay_s", numbers[0])
        elif effect.name == "gyro_low_pass":
            hertz = _not_negative("gyro_low_pass", "bandwidth_hz", numbers[0])
            sensor["gyro_lag"] = 1.0 / (2.0 * math.pi * hertz) if hertz > 0.0 else 0.0
        elif effect.name == "gyro_bias":
            sensor["gyro_bias"] = np.radians(numbers)
        elif effect.name == "accelerometer_bias":
            sensor["accelerometer_bias"] = np.multiply(numbers, STANDARD_GRAVITY)
        elif effect.name == "imu_misalignment":
            sensor["mounting"] = rotation_matrix(np.radians(numbers))
            sensor["rotated"] = any(numbers)
        elif effect.name == "imu_lever_arm":
            sensor["lever"] = numbers
        elif effect.name == "attitude_filter_lean":
            sensor["lean"] = numbers[0]
    return record


def reading_lag_s(model: Model) -> float:
    """Time constant of the battery report, 0 where the model has no battery_reading_lag."""
    for term in model.effects:
        if term.name == "battery_reading_lag":
            values = find_effect(term.name).values(
                {name: one.value for name, one in term.parameters.items()}
            )
            return _not_negative(term.name, "time_constant_s", values["time_constant_s"])
    return 0.0


def reported_supply(supply: ArrayLike, lag_s: float, period_s: float) -> Array:
    """What a lagging report shows of a supply voltage (n,), settled at the first row."""
    volts = np.asarray(supply, np.float64)
    if lag_s == 0.0:
        return volts.copy()
    from scipy.signal import lfilter

    keep = math.exp(-period_s / lag_s)
    out, _ = lfilter([1.0 - keep], [1.0, -keep], volts, zi=[keep * volts[0]])
    return np.asarray(out, np.float64)


def supply_behind(reported: ArrayLike, lag_s: float, period_s: float) -> Array:
    """The supply voltage (n,) behind a lagging report: the lag undone, row by row.

    The inverse multiplies the report's resolution by lag / period, white noise that the motors,
    fifty times slower than a row, average away again. What is left is limited: the result never
    leaves a quarter of the report around it.
    """
    volts = np.asarray(reported, np.float64)
    if lag_s == 0.0:
        return volts.copy()
    keep = math.exp(-period_s / lag_s)
    before = np.concatenate([volts[:1], volts[:-1]])
    behind = (volts - keep * before) / (1.0 - keep)
    return np.clip(behind, (1.0 - MOST_CHANGE) * volts, (1.0 + MOST_CHANGE) * volts)


def _not_negative(effect: str, parameter: str, value: float) -> float:
    if value < 0.0:
        raise BadInputError(f"effect {effect}: {parameter} is {value:g}, must not be negative")
    return value
