"""The live twin as rerun columns: what was measured, what was predicted, and the gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from groundstation.rerun_log.channels import DEVICE_TIME, PITCH, ROLL, YAW
from groundstation.rerun_log.device_clock import LiveClock
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

TWIN = "/twin"
GAP = f"{TWIN}/gap"
MEASURED, PREDICTED = "measured", "predicted"
ROLE_S = {MEASURED: 1.0, PREDICTED: 2.0}
"""Widths of the lines."""


@dataclass(frozen=True, slots=True)
class Shown:
    """Some of the nine channels, as people read them."""

    entity: str
    columns: slice
    per_si: float
    names: tuple[str, ...]
    colors: tuple[tuple[int, int, int], ...]


GROUPS = (
    Shown(f"{TWIN}/rates", slice(0, 3), 180 / np.pi, ("roll", "pitch", "yaw"), (ROLL, PITCH, YAW)),
    Shown(f"{TWIN}/accelerometer", slice(5, 6), 1 / STANDARD_GRAVITY, ("up",), (YAW,)),
    Shown(
        f"{TWIN}/attitude", slice(6, 9), 180 / np.pi, ("roll", "pitch", "yaw"), (ROLL, PITCH, YAW)
    ),
)
GAPS = (
    "gyro x",
    "gyro y",
    "gyro z",
    "accelerometer x",
    "accelerometer y",
    "accelerometer z",
    "roll",
    "pitch",
    "yaw",
)
GAP_COLORS = (
    ROLL,
    PITCH,
    YAW,
    (255, 167, 38),
    (212, 225, 87),
    (38, 198, 218),
    (240, 150, 150),
    (170, 220, 170),
    (150, 195, 250),
)


class TwinLog:
    """Writes to one rerun stream, on the axis of ``clock``."""

    def __init__(self, stream: rr.RecordingStream, clock: LiveClock) -> None:
        self._stream = stream
        self._clock = clock

    def names(self) -> None:
        """Names and colours of the series: static, sent once."""
        for group in GROUPS:
            for role, width in ROLE_S.items():
                shades = [_shade(color, role) for color in group.colors]
                names = [f"{name}, {role}" for name in group.names]
                lines = rr.SeriesLines(names=names, colors=shades, widths=width)
                self._stream.log(f"{group.entity}/{role}", lines, static=True, strict=True)
        lines = rr.SeriesLines(names=GAPS, colors=GAP_COLORS, widths=2.0)
        self._stream.log(GAP, lines, static=True, strict=True)

    def show(
        self, segment: int, time_s: Array, measured: Array, predicted: Array, gap: Array
    ) -> None:
        """Log (m, 9) SI at device times (m,), and the gap (9,) over all of them."""
        times = self._clock.at_device(segment, time_s)
        if times is None:
            return  # of before a restart
        for group in GROUPS:
            for role, values in ((MEASURED, measured), (PREDICTED, predicted)):
                self._send(f"{group.entity}/{role}", times, values[:, group.columns] * group.per_si)
        if np.isfinite(gap).any():
            self._send(GAP, times[-1:], gap[None])

    def _send(self, entity: str, times: NDArray[np.int64], values: Array) -> None:
        column = rr.TimeColumn(DEVICE_TIME, duration=times.astype("timedelta64[ns]"))
        self._stream.send_columns(
            entity, indexes=[column], columns=rr.Scalars.columns(scalars=values), strict=True
        )


def _shade(color: tuple[int, int, int], role: str) -> tuple[int, int, int]:
    """What was measured is pale, what was predicted in full colour."""
    if role == PREDICTED:
        return color
    r, g, b = ((each + 2 * 255) // 3 for each in color)
    return r, g, b
