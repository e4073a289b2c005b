"""Batches: raw packets as a link delivers them, and decoded samples as columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.packet import (
    ACCELEROMETER_M_S2,
    ANGLE_RAD,
    BATTERY_V,
    DUTY,
    GYRO_RAD_S,
    TICK_S,
    Packets,
    decode,
    motor_counts,
)

MOST_COUNTS = 2**31 - 1
"""Counts to which values are held that no sensor can measure, 1e30 for none say."""
OVERDRIVEN = 1.001
"""A duty beyond full by more than rounding."""


@dataclass(frozen=True, slots=True)
class RawBatch:
    """Packets as received, in order of arrival.

    packets: (n, 32) uint8.
    host_time_ns: (n,) int64, Unix time at which the host saw each packet: may be late
        (a blocked loop), never early.
    """

    packets: Packets
    host_time_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.packets)

    @staticmethod
    def concatenate(batches: Sequence[RawBatch]) -> RawBatch:
        if not batches:
            return RawBatch(np.empty((0, 32), np.uint8), np.empty(0, np.int64))
        return RawBatch(
            np.concatenate([b.packets for b in batches]),
            np.concatenate([b.host_time_ns for b in batches]),
        )


@dataclass(frozen=True, slots=True)
class SampleBatch:
    """Decoded samples, one row each, without duplicates, in order of device time.

    Frames and signs as in the design: body FLU, roll left side up positive, pitch nose DOWN
    positive, yaw counter-clockwise positive. A channel the source does not have is NaN.

    ticks: (n,) int64, unwrapped device time in units of ``tick_s``.
    tick_s: seconds per tick (73/72 us for the telemetry packet, 1 us for microSD logs).
    host_time_ns: (n,) int64, Unix time of the earliest copy's arrival.
    segment: (n,) int32, counts restarts of the device; device time is continuous inside one.
    copies: (n,) uint8, how many agreeing copies arrived (saturates at 255).
    battery_v: (n,) float32.
    duty: (n, 4) float32, 0..1, the PWM that acted over the 2 ms before the gyro sample; where
        rows are slower, the mean of two such settings if the source has both.
    duty_step: (n, 4) float32, the second of these two settings less the first; NaN where ``duty``
        is no such mean.
    gyro: (n, 3) float32, rad/s.
    accelerometer: (n, 3) float32, specific force in m/s^2.
    attitude: (n, 3) float32, roll pitch yaw in rad.
    rotor_rev_s: (n, 4) float32, measured rotor speeds where the source has them.
    debug: (n,) uint32.
    """

    ticks: NDArray[np.int64]
    host_time_ns: NDArray[np.int64]
    segment: NDArray[np.int32]
    copies: NDArray[np.uint8]
    battery_v: NDArray[np.float32]
    duty: NDArray[np.float32]
    gyro: NDArray[np.float32]
    accelerometer: NDArray[np.float32]
    attitude: NDArray[np.float32]
    rotor_rev_s: NDArray[np.float32]
    debug: NDArray[np.uint32]
    duty_step: NDArray[np.float32]
    tick_s: float = TICK_S

    def __len__(self) -> int:
        return len(self.ticks)

    def __repr__(self) -> str:
        """How much there is of which channels; the numbers are in the columns."""
        if not len(self):
            return "SampleBatch(empty)"
        known = [name for name in _PHYSICAL if np.isfinite(getattr(self, name)).any()]
        step_s = float(np.median(np.diff(self.ticks))) * self.tick_s if len(self) > 1 else np.inf
        span_s = float(self.ticks[-1] - self.ticks[0]) * self.tick_s
        rate = f"{span_s:.2f} s at {1 / step_s:.0f} Hz" if step_s > 0 else f"{span_s:.2f} s"
        return f"SampleBatch({len(self)} rows, {rate}: {', '.join(known)})"

    def to_arrow(self) -> Any:
        """A ``pyarrow.Table`` of every column in SI, a vector's parts apart (``gyro_x``,
        ``duty_1``, ``attitude_roll``), with ``time_s``; ``to_arrow().to_pandas()`` makes a frame.
        """
        import pyarrow

        table: dict[str, NDArray[Any]] = {"time_s": self.time_s}
        for name in COLUMNS:
            values = getattr(self, name)
            parts = _PARTS.get(name)
            if parts is None:
                table[name] = values
            else:
                table |= {f"{name}_{part}": values[:, i] for i, part in enumerate(parts)}
        return pyarrow.table(table)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Device time in seconds, shape (n,)."""
        return self.ticks.astype(np.float64) * self.tick_s

    @property
    def overdriven(self) -> NDArray[np.bool_]:
        """Rows (n,) with a motor beyond full duty, which none can be: nothing was received there.

        Who joins the topics of a flight on one clock may extrapolate those that ended first.
        """
        return np.asarray((self.duty > OVERDRIVEN).any(axis=1))

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> SampleBatch:
        """The chosen rows as a new batch."""
        return replace(self, **{name: getattr(self, name)[rows] for name in COLUMNS})

    @staticmethod
    def concatenate(batches: Sequence[SampleBatch]) -> SampleBatch:
        """Join batches that share ``tick_s``; an empty sequence gives an empty batch."""
        if not batches:
            return empty_samples(0)
        if len({batch.tick_s for batch in batches}) > 1:
            raise ValueError("sample batches with different tick lengths cannot be joined")
        columns = {
            name: np.concatenate([getattr(batch, name) for batch in batches]) for name in COLUMNS
        }
        return SampleBatch(**columns, tick_s=batches[0].tick_s)


COLUMNS: tuple[str, ...] = tuple(f.name for f in fields(SampleBatch) if f.name != "tick_s")
"""Names of the per-row arrays of a ``SampleBatch``."""

_PARTS: dict[str, Sequence[str]] = {
    "duty": "1234",
    "gyro": "xyz",
    "accelerometer": "xyz",
    "attitude": ("roll", "pitch", "yaw"),
    "rotor_rev_s": "1234",
    "duty_step": "1234",
}
_PHYSICAL = ("battery_v", *_PARTS)
_INTEGER_TYPES: dict[str, type[np.generic]] = {
    "ticks": np.int64,
    "host_time_ns": np.int64,
    "segment": np.int32,
    "copies": np.uint8,
    "debug": np.uint32,
}


def empty_samples(rows: int, tick_s: float = TICK_S) -> SampleBatch:
    """A batch of ``rows`` rows: integers 0, copies 1, every physical channel NaN."""
    columns: dict[str, NDArray[Any]] = {}
    for name in COLUMNS:
        if name in _INTEGER_TYPES:
            columns[name] = np.zeros(rows, _INTEGER_TYPES[name])
        else:
            shape = (rows, len(_PARTS[name])) if name in _PARTS else (rows,)
            columns[name] = np.full(shape, np.nan, np.float32)
    columns["copies"][:] = 1
    return SampleBatch(**columns, tick_s=tick_s)


def samples_from_packets(
    packets: Packets,
    ticks: NDArray[np.int64],
    host_time_ns: NDArray[np.int64],
    segment: NDArray[np.int32],
    copies: NDArray[np.uint8],
) -> SampleBatch:
    """Decode (n, 32) deduplicated packets into physical units."""
    records = decode(packets)
    attitude = records["angles"] * np.float32(ANGLE_RAD)
    attitude[:, 1] *= -1  # the firmware's pitch is nose up positive
    return SampleBatch(
        ticks=ticks,
        host_time_ns=host_time_ns,
        segment=segment,
        copies=copies,
        battery_v=records["battery"] * np.float32(BATTERY_V),
        duty=motor_counts(records) * np.float32(DUTY),
        gyro=records["gyro"] * np.float32(GYRO_RAD_S),
        accelerometer=records["accelerometer"] * np.float32(ACCELEROMETER_M_S2),
        attitude=attitude,
        rotor_rev_s=np.full((len(records), 4), np.nan, np.float32),
        debug=records["debug"].astype(np.uint32),
        duty_step=np.full((len(records), 4), np.nan, np.float32),
    )


def packet_counts(samples: SampleBatch) -> dict[str, NDArray[np.int64]]:
    """The packet's integers behind ``samples``: the inverse of ``samples_from_packets``.

    Keys: timestamp (unwrapped), battery, motors, gyro, accelerometer, angles (pitch in the
    packet's nose-up convention), debug. Exact for samples that came from packets. A channel
    without data (NaN) gives 0, a value beyond 32 bits their limit.
    """
    angles = _counts(samples.attitude, ANGLE_RAD)
    angles[:, 1] *= -1
    return {
        "timestamp": samples.ticks.astype(np.int64),
        "battery": _counts(samples.battery_v, BATTERY_V),
        "motors": _counts(samples.duty, DUTY),
        "gyro": _counts(samples.gyro, GYRO_RAD_S),
        "accelerometer": _counts(samples.accelerometer, ACCELEROMETER_M_S2),
        "angles": angles,
        "debug": samples.debug.astype(np.int64),
    }


def _counts(values: NDArray[np.float32], unit: float) -> NDArray[np.int64]:
    scaled = np.nan_to_num(values.astype(np.float64) / unit, nan=0.0)
    return np.rint(scaled.clip(-MOST_COUNTS, MOST_COUNTS)).astype(np.int64)
