"""What lies between the craft and its telemetry beside the laws of its sensors: delay, mounting
and attitude filter.

Reported angles are the sensor's true attitude, less what the firmware's gyro filter keeps back
(``sensing.estimated``), or, where an effect gives the attitude filter gains, those of the
firmware's filter (``sensing.fuse``). Everything is late by the delay.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.craft import acting, craft_of_model
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.rotations import attitude_of_matrix, quaternion_of_attitude
from groundstation.dynamics.sensing import SMOOTHING, UNSMOOTHED
from groundstation.telemetry.arrays import Array

FILTER = 10
"""Numbers of an attitude filter's state."""
SENSORS = np.dtype(
    [
        ("delay", "f8"),  # s
        ("gains", "f8", (2,)),  # of the attitude filter, 1/s and 1/s^2; 0: angles are the truth
        ("smoothing", "f8"),  # of the accelerometer before that filter (sensing.smoothed)
        ("mounting", "f8", (3, 3)),  # body <- sensor: undoes what the sensors' laws turn
        ("mount", "f8", (4,)),  # the same as a quaternion, of the reported angles
        ("rotated", "i8"),
        ("zero", "f8", (6,)),  # what gyro and accelerometer show of nothing
    ]
)


def delay_of_model(model: Model) -> float:
    """How late every measurement is, s."""
    return float(sum(e.law(tuple(v.values())) for e, v in acting(model) if e.stage == "delay"))


def shown_rotors(model: Model, rev_s: Array, period_s: float) -> Array:
    """What a sensor of rotor speeds shows (n, 4) of true ones at rows ``period_s`` apart."""
    for effect, values in acting(model):
        if effect.stage == "tachometer":
            rev_s = lagged(rev_s, effect.law(tuple(values.values())), period_s)
    return rev_s


def lagged(signals: Array, lag_s: float, period_s: float) -> Array:
    """First-order lag of signals (n,) or (n, k) that are straight lines between rows; settled at
    the first row."""
    from scipy.signal import lfilter

    keep = float(np.exp(-period_s / lag_s))
    now = 1.0 - lag_s / period_s * (1.0 - keep)
    before = 1.0 - keep - now
    start = (before + keep) * signals[:1]
    filtered, _ = lfilter([now, before], [1.0, -keep], signals, axis=0, zi=start)
    return np.asarray(filtered)


def resting_sensors(craft: np.void) -> Array:
    """What the sensors of a craft at rest remember, (SENSOR_STATES,)."""
    felt = np.array([0.0, 0.0, 0.0, 0.0, 0.0, craft["gravity"]])
    return np.where(craft["follows"] < 0, craft["sensor_initial"], felt[craft["follows"]])


def sensors_of_model(model: Model) -> NDArray[np.void]:
    """A record of ``SENSORS``, shape (1,): an ideal sensor, and what the model's effects change.

    Raises BadInputError for an effect that does not exist or a value that cannot be.
    """
    from groundstation.dynamics.sensing import settled_reading

    record = np.zeros(1, SENSORS)
    sensor = record[0]
    sensor["delay"] = delay_of_model(model)
    for effect, values in acting(model):
        if effect.stage == "attitude":
            sensor["gains"] += effect.law(tuple(values.values()))
    today = model_vehicle(model).firmware == "2.x"
    sensor["smoothing"] = UNSMOOTHED if today else SMOOTHING
    sensor["mounting"] = np.eye(3)
    craft = craft_of_model(model)
    if craft[0]["acts_sensor"]:
        settled_reading(craft[0], np.zeros(3), np.zeros(3), sensor["zero"])
        turned, out = np.empty((3, 3)), np.empty(6)
        for axis, unit in enumerate(np.eye(3)):
            settled_reading(craft[0], unit, np.zeros(3), out)
            turned[:, axis] = out[:3] - sensor["zero"][:3]
        if not np.allclose(turned, np.eye(3), rtol=0.0, atol=1e-9):
            u, _, v = np.linalg.svd(turned.T)  # the rotation next to what may also scale
            sensor["mounting"], sensor["rotated"] = u @ v, 1
    sensor["mount"] = quaternion_of_attitude(attitude_of_matrix(sensor["mounting"]))
    return record
