"""The single channels of a sample batch, in the units in which people read them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch


@dataclass(frozen=True, slots=True)
class Channel:
    """One column of numbers: shown value = ``scale`` x the sample's own value."""

    name: str
    unit: str
    suffix: str
    """The unit as part of a table's header."""
    field: str
    index: int | None
    scale: float

    @property
    def header(self) -> str:
        """Name and unit, as in ``gyro_x_deg_s``; a duty has no unit."""
        return f"{self.name}_{self.suffix}" if self.suffix else self.name

    def of(self, samples: SampleBatch) -> NDArray[np.float32]:
        """The channel in the samples' own unit, shape (n,), a view."""
        values: NDArray[np.float32] = getattr(samples, self.field)
        return values if self.index is None else values[:, self.index]

    def shown(self, samples: SampleBatch) -> NDArray[np.float64]:
        """The channel in ``unit``, shape (n,)."""
        return self.of(samples).astype(np.float64) * self.scale

    def is_in(self, samples: SampleBatch) -> bool:
        """Whether the channel has any value."""
        return bool(np.isfinite(self.of(samples)).any())


def _channels() -> tuple[Channel, ...]:
    degree, g = 180 / np.pi, 1 / STANDARD_GRAVITY
    angles = ("roll", "pitch", "yaw")
    motors = range(4)
    return (
        Channel("battery", "V", "v", "battery_v", None, 1.0),
        *(Channel(f"duty_{m + 1}", "1", "", "duty", m, 1.0) for m in motors),
        *(Channel(f"gyro_{a}", "deg/s", "deg_s", "gyro", i, degree) for i, a in enumerate("xyz")),
        *(
            Channel(f"accelerometer_{a}", "g", "g", "accelerometer", i, g)
            for i, a in enumerate("xyz")
        ),
        *(Channel(a, "deg", "deg", "attitude", i, degree) for i, a in enumerate(angles)),
        *(Channel(f"rotor_{m + 1}", "rpm", "rpm", "rotor_rev_s", m, 60.0) for m in motors),
        *(Channel(f"duty_step_{m + 1}", "1", "", "duty_step", m, 1.0) for m in motors),
    )


CHANNELS = _channels()
"""Battery, duties, gyro, accelerometer, attitude (pitch nose down positive), rotors, and what slow
rows know of two settings."""
UNUSUAL = ("rotor_rev_s", "duty_step")
"""Fields that most sources do not have and nobody misses; older recordings know them not."""
