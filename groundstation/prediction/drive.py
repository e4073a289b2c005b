"""What a model's motors make of a run's inputs, and when the craft flies by that.

Nothing here was corrected by what the sensors showed: a model's motors are driven by the recorded
PWM and battery voltage alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.craft import Crafts, craft_of_model
from groundstation.dynamics.hover import settled_rev_s
from groundstation.dynamics.law import FAR_M
from groundstation.dynamics.model import Model
from groundstation.dynamics.sensors import sensors_of_model
from groundstation.errors import BadInputError
from groundstation.prediction.battery_rhythm import between_readings
from groundstation.prediction.height import CLEAR_M, heights_of, lifting, rise_of
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import spans

Mask = NDArray[np.bool_]

TURNING = 0.1
"""Duty above which a motor turns."""
LANDED = 0.85
"""Thrust over weight at which a craft has come back to the ground."""


class Flown(Protocol):
    """The channels of a run (``identification.runs.Run`` is one); see there for units."""

    @property
    def period_s(self) -> float: ...
    @property
    def duty(self) -> Array: ...
    @property
    def settings(self) -> Array: ...
    @property
    def supply_v(self) -> Array: ...
    @property
    def gyro(self) -> Array: ...
    @property
    def accelerometer(self) -> Array: ...
    @property
    def attitude(self) -> Array: ...


@dataclass(frozen=True, slots=True)
class Drive:
    """A model on a run's inputs: all that does not depend on what was measured.

    speed: (2 n - 1, 4) rev/s at every row less the dead time and half-way between. push: (2 n - 1,
    5) what they do to the craft at rest at these points: specific force along z far from the
    ground and on it, m/s^2, and angular acceleration, rad/s^2.
    """

    craft: Crafts
    sensor: NDArray[np.void]
    period_s: float
    speed: Array
    push: Array

    @property
    def rotor_rev_s(self) -> Array:
        """Rotor speeds (n, 4) behind each row."""
        return np.ascontiguousarray(self.speed[::2])

    def since(self, row: int) -> Drive:
        """The same from a row on."""
        return replace(
            self,
            speed=self.speed[2 * row :],
            push=self.push[2 * row :],
        )


def drive_run(model: Model, run: Flown) -> Drive:
    """The motors of a model on a run's inputs.

    They start settled at the first row's voltage, which is forgotten after half a second.

    Raises BadInputError where PWM or battery voltage are missing.
    """
    from groundstation.prediction.kernels import drives, spin

    for name in ("duty", "supply_v"):
        if not np.isfinite(getattr(run, name)).all():
            raise BadInputError(f"{name} is missing in some rows; a model cannot fly on them")
    if len(run.duty) < 2:
        raise BadInputError("a run of one row cannot be flown; give at least two")
    craft, sensor = craft_of_model(model), sensors_of_model(model)
    supply = np.ascontiguousarray(1000.0 * between_readings(run.supply_v), np.float64)
    duty = np.ascontiguousarray(run.settings, np.float64)
    start = settled_rev_s(craft, run.duty[0], float(supply[0]))
    speed = np.empty((2 * len(supply) - 1, 4))
    spin(craft[0], duty, supply, run.period_s, float(sensor[0]["delay"]), start, speed)
    push = np.empty((len(speed), 5))
    drives(craft[0], speed, run.period_s, push)
    return Drive(craft, sensor, run.period_s, speed, push)


def flying_rows(run: Flown, drive: Drive, height: Array) -> Mask:
    """Rows (n,) in the air: from the first thrust above the weight, or from where the recording
    tells a height (a model without what the ground does has too little thrust there), until it has
    gone for good. height: (n,) as ``reckoned_height`` has it."""
    turning = turning_rows(run)
    one = drive.craft[0]
    clear = np.isfinite(height) & (height > CLEAR_M)
    lift, low_lift = drive.push[::2, 0] / one["gravity"], drive.push[::2, 1] / one["gravity"]
    flying = np.zeros(len(turning), np.bool_)
    for first, last in spans(turning):
        if first > 0:
            near = np.where(clear[first:last], LANDED, 1.0)
            up = np.flatnonzero(low_lift[first:last] > near)
            if len(up) == 0:
                continue
            first += up[0]
        if last < len(turning):
            low = np.flatnonzero(lift[first:last] < LANDED)
            high = np.flatnonzero(lift[first:last] > LANDED)
            if len(low) and len(high):
                last = first + high[-1] + 1
        flying[first:last] = True
    return flying


def turning_rows(run: Flown) -> Mask:
    """Rows (n,) in which every motor turns."""
    return np.asarray((run.duty > TURNING).all(axis=1))


def reckoned_height(run: Flown) -> Array:
    """Height (n,) in m while motors lift, infinite where a recording cannot tell it."""
    height = np.full(len(run.duty), np.inf)
    rise = rise_of(run.attitude, run.accelerometer)
    still = ~np.asarray((run.duty > 0.0).any(axis=1))
    for begun, ended in spans(turning_rows(run)):
        start, stop = lifting(run.duty, begun, ended, run.period_s)
        still[begun:start] = True
        height[start:stop], _ = heights_of(rise, still, start, stop, run.period_s)
    return height


def height_of(height: Array, flying: Mask) -> Array:
    """What was reckoned as height above ground (n,) in m: ``FAR_M`` in flight where it is not
    known, 0 elsewhere."""
    return np.where(flying, np.clip(height, 0.0, FAR_M), 0.0)
