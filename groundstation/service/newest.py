"""The newest sample: as clients are told it, and what it says of the motors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from groundstation.service.motor_stop import Motors
from groundstation.service.requests import Telemetry
from groundstation.telemetry.samples import SampleBatch


class Newest:
    """now_ns: the present on the time base of the packets. batch: None before the first."""

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self.batch: SampleBatch | None = None
        self._now_ns = now_ns

    def samples(self, batch: SampleBatch) -> None:
        """A batch with one row at least."""
        self.batch = batch

    def telemetry(self) -> Telemetry | None:
        """The last row, in the units of the API; what a source does not have is None."""
        batch = self.batch
        if batch is None:
            return None
        roll, pitch, yaw = _numbers(np.degrees(batch.attitude[-1]))
        (battery,) = _numbers(batch.battery_v[-1:])
        return Telemetry(
            age_s=round(self._age_s(batch), 4),
            timestamp=int(batch.ticks[-1]),
            roll_deg=roll,
            pitch_deg=pitch,
            yaw_deg=yaw,
            gyro_dps=_numbers(np.degrees(batch.gyro[-1])),
            battery_v=battery,
            motors=_numbers(batch.duty[-1]),
        )

    def motors(self) -> Motors | None:
        """What the craft says of its motors; None where it does not."""
        batch = self.batch
        if batch is None or np.isnan(batch.duty[-1]).any():
            return None
        return Motors(self._age_s(batch), float(batch.duty[-1].max()))

    def _age_s(self, batch: SampleBatch) -> float:
        return (self._now_ns() - int(batch.host_time_ns[-1])) * 1e-9


def _numbers(values: Any) -> list[float | None]:
    return [None if np.isnan(value) else round(float(value), 4) for value in values]
