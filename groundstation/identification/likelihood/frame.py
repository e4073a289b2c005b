"""What stays fixed in a search, and the craft and effects that a point of it means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import msgspec
import numpy as np

from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.effect import Craft, Key
from groundstation.dynamics.model import BodyConstants, Model, vehicle_model, with_motor
from groundstation.dynamics.vehicle import MotorConstants, Motors, Vehicle
from groundstation.identification.likelihood.laws import Acting, acting
from groundstation.identification.likelihood.parameters import (
    BODY_KEYS,
    KEYS,
    MOTOR_KEYS,
    VARIANTS,
    Variant,
)


@dataclass(frozen=True)
class Frame:
    """The craft's configuration and scale, filter gains, the user's own effects, and the rotors'
    motors in proportion to each other (None: alike).

    gyro_filter_hz, accelerometer_filter_hz: corners of the on-board low-passes of second order that
    the readings have passed; 0: none.
    """

    vehicle: Vehicle
    motors: Motors | None = None
    rate_gain: tuple[float, float, float] = (0.5, 0.5, 0.5)
    own: tuple[Variant, ...] = ()
    gyro_filter_hz: float = 0.0
    accelerometer_filter_hz: float = 0.0

    @cached_property
    def unknowns(self) -> dict[str, Key]:
        """Every effect's, by key."""
        return KEYS | {one.key: one for variant in self.own for one in variant.unknowns}

    @cached_property
    def variants(self) -> dict[str, Variant]:
        """Of each unknown."""
        return {key: one for one in (*VARIANTS, *self.own) for key in one.keys}

    def acting(self, point: Mapping[str, float]) -> dict[str, Acting]:
        """The effects that are there at a point, by their variant's label."""
        found = {v.label: acting(v.unknowns, point) for v in (*VARIANTS, *self.own)}
        return {label: one for label, one in found.items() if one is not None}

    def model(self, point: Mapping[str, float]) -> Model:
        """The base model of a point."""
        model = msgspec.structs.replace(
            vehicle_model(self.vehicle),
            motors=self.motors,
            body=BodyConstants(*(point[key] for key in BODY_KEYS)),
        )
        return with_motor(model, MotorConstants(*(point[key] for key in MOTOR_KEYS)))

    def record(self, point: Mapping[str, float]) -> np.void:
        """The same as kernels take it, a record of ``dynamics.craft.CRAFT``."""
        return craft_of_model(self.model(point))[0]

    def craft(self, point: Mapping[str, float]) -> Craft:
        """The same as laws take it."""
        record = self.record(point)
        numbers = (record[field].tolist() for field in Craft._fields)
        plain: Any = (tuple(one) if isinstance(one, list) else one for one in numbers)
        return Craft(*plain)
