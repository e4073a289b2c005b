"""The 32-byte telemetry packet (thesis section 5.3) and its physical units.

One structured type serves one packet and millions: ``decode`` is a view, not a loop.

| offset | field | unit |
|---|---|---|
| 0 | timestamp u16 | ticks of 73/72 us, wraps every 66.4 ms |
| 2 | battery u16 | mV |
| 4 | motors 4 x 12 bits, M1 lowest | 1/4096 duty, steps of 8 |
| 10 | gyro 3 x i16 | 1/16.384 deg/s |
| 16 | accelerometer 3 x i16 | 1/4096 g |
| 22 | roll, pitch, yaw i16 | 0.01 deg; pitch nose up positive in the packet |
| 28 | debug u32 | free, or half a rotor revolution in ticks on the motor bench |
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

PACKET_BYTES = 32
TICK_S = 73e-6 / 72
"""One count of the microsecond timer, which divides 72 MHz by 73 (seconds)."""
SAMPLE_PERIOD_S = 0.002
SAMPLE_TICKS = SAMPLE_PERIOD_S / TICK_S
"""Ticks between two samples: 1972.603."""
TIMESTAMP_MODULUS = 1 << 16
STANDARD_GRAVITY = 9.80665

GYRO_RAD_S = math.radians(1 / 16.384)
"""rad/s per count."""
ACCELEROMETER_M_S2 = STANDARD_GRAVITY / 4096
"""m/s^2 per count."""
ANGLE_RAD = math.radians(0.01)
"""rad per count."""
DUTY = 1 / 4096
FULL_16_BIT = 65535.0
"""Full scale of the firmware's thrust and PWM where they have 16 bits, in it and in its logs."""
BATTERY_V = 1e-3
MOTOR_STEP = 8
"""9-bit PWM shifted left by three: every motor count is a multiple of this."""

PACKET_DTYPE = np.dtype(
    [
        ("timestamp", "<u2"),
        ("battery", "<u2"),
        ("motors", "u1", (6,)),
        ("gyro", "<i2", (3,)),
        ("accelerometer", "<i2", (3,)),
        ("angles", "<i2", (3,)),
        ("debug", "<u4"),
    ]
)
assert PACKET_DTYPE.itemsize == PACKET_BYTES

Packets = NDArray[np.uint8]
"""Raw packets, shape (n, 32)."""


def as_packets(data: bytes | bytearray | memoryview) -> Packets:
    """Whole packets in ``data`` as an (n, 32) array; a trailing fragment is left out."""
    whole = len(data) // PACKET_BYTES
    return np.frombuffer(data, np.uint8, whole * PACKET_BYTES).reshape(whole, PACKET_BYTES)


def decode(packets: Packets) -> NDArray[np.void]:
    """View (n, 32) bytes as ``PACKET_DTYPE`` records, shape (n,), counts as sent."""
    return np.ascontiguousarray(packets, np.uint8).view(PACKET_DTYPE).reshape(-1)


def motor_counts(records: NDArray[np.void]) -> NDArray[np.uint16]:
    """Unpack the four 12-bit motor values, shape (n, 4), unit 1/4096 duty."""
    packed = records["motors"].astype(np.uint16)
    low, middle, high = packed[:, 0::3], packed[:, 1::3], packed[:, 2::3]
    counts = np.empty((len(records), 4), np.uint16)
    counts[:, 0::2] = low | ((middle & 0x0F) << 8)
    counts[:, 1::2] = (middle >> 4) | (high << 4)
    return counts


def encode(
    timestamp: ArrayLike,
    battery: ArrayLike,
    motors: ArrayLike,
    gyro: ArrayLike,
    accelerometer: ArrayLike,
    angles: ArrayLike,
    debug: ArrayLike,
) -> Packets:
    """Pack counts into (n, 32) bytes.

    ``timestamp`` may be unwrapped: it is taken modulo 65536. ``motors`` (n, 4) are 12-bit
    counts, ``angles`` (n, 3) are in the packet's convention (pitch nose up positive).

    Raises ValueError where a count does not fit its field.
    """
    stamps = np.atleast_1d(np.asarray(timestamp)).astype(np.int64)
    records = np.zeros(len(stamps), PACKET_DTYPE)
    records["timestamp"] = (stamps % TIMESTAMP_MODULUS).astype(np.uint16)
    fields: list[tuple[str, Any]] = [
        ("battery", np.atleast_1d(np.asarray(battery))),
        ("gyro", np.atleast_2d(np.asarray(gyro))),
        ("accelerometer", np.atleast_2d(np.asarray(accelerometer))),
        ("angles", np.atleast_2d(np.asarray(angles))),
        ("debug", np.atleast_1d(np.asarray(debug))),
    ]
    for name, values in fields:
        limits = np.iinfo(records[name].dtype)
        _require_range(name, values, int(limits.min), int(limits.max))
        records[name] = values
    counts = np.atleast_2d(np.asarray(motors))
    _require_range("motors", counts, 0, 4095)
    pairs = counts.astype(np.uint32)
    first, second = pairs[:, 0::2], pairs[:, 1::2]
    records["motors"][:, 0::3] = first & 0xFF
    records["motors"][:, 1::3] = (first >> 8) | ((second & 0x0F) << 4)
    records["motors"][:, 2::3] = second >> 4
    return records.view(np.uint8).reshape(-1, PACKET_BYTES)


def _require_range(name: str, values: NDArray[Any], low: int, high: int) -> None:
    outside = (values < low) | (values > high)
    if outside.any():
        raise ValueError(f"packet field {name}: {values[outside][0]} is outside {low}..{high}")
