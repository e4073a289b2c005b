"""The 32-byte telemetry packet (thesis section 5.3), and how it travels: framed on a byte
stream, or in the bridge's USB frames.
"""

from __future__ import annotations

import binascii
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

# The 32-byte telemetry packet (thesis section 5.3) and its physical units.
#
# One structured type serves one packet and millions: ``decode`` is a view, not a loop.
#
# | offset | field | unit |
# |---|---|---|
# | 0 | timestamp u16 | ticks of 73/72 us, wraps every 66.4 ms |
# | 2 | battery u16 | mV |
# | 4 | motors 4 x 12 bits, M1 lowest | 1/4096 duty, steps of 8 |
# | 10 | gyro 3 x i16 | 1/16.384 deg/s |
# | 16 | accelerometer 3 x i16 | 1/4096 g |
# | 22 | roll, pitch, yaw i16 | 0.01 deg; pitch nose up positive in the packet |
# | 28 | debug u32 | free, or half a rotor revolution in ticks on the motor bench |


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


# Packets on a byte stream: COBS with a checksum and a zero byte at the end of each frame.
#
# A frame is 36 bytes: the packet and its CRC-16/CCITT-FALSE (low byte first, as every field of
# the packet), 34 bytes, stuffed by COBS into 35 that hold no zero, then a zero. So a zero in the
# stream is always the end of a frame, and a reader that starts anywhere, or finds damage, is in
# step again with the next one.
#
# COBS: S. Cheshire and M. Baker, "Consistent overhead byte stuffing", IEEE/ACM Transactions on
# Networking 7(2), 1999. CRC: polynomial 0x1021, initial value 0xFFFF, not reflected; the check
# value of "123456789" is 0x29B1.


CRC_BYTES = 2
CRC_INITIAL = 0xFFFF
STUFFED_BYTES = 1 + PACKET_BYTES + CRC_BYTES
"""Packet and checksum after COBS, which adds one byte to anything shorter than 254."""
DELIMITER = b"\0"
SERIAL_FRAME_BYTES = STUFFED_BYTES + len(DELIMITER)
BAUD = 2_000_000
"""Speed of the line, 8N1: 2000 frames/s are 36 % of it."""


def crc16(data: bytes | bytearray | memoryview) -> int:
    """CRC-16/CCITT-FALSE."""
    return binascii.crc_hqx(data, CRC_INITIAL)


def frame_packets(packets: Packets) -> bytes:
    """The stream of (n, 32) packets: n frames of 36 bytes."""
    data = packets.tobytes()
    frames = []
    for at in range(0, len(data), PACKET_BYTES):
        packet = data[at : at + PACKET_BYTES]
        frames.append(_stuff(packet + crc16(packet).to_bytes(CRC_BYTES, "little")))
    return b"".join(frames)


def port_and_baud(address: str) -> tuple[str, int]:
    """``PORT`` or ``PORT@BAUD``, as typed, in its parts. Raises ValueError for no usable baud."""
    port, mark, digits = address.rpartition("@")
    if not mark or not digits.isdecimal():
        return address, BAUD
    if int(digits) == 0:
        raise ValueError(f"serial port {address}: the baud rate must be greater than 0")
    return port, int(digits)


class Deframer:
    """The packets of a byte stream that may begin anywhere and be damaged anywhere.

    frames: whole ones with a right checksum. damaged: stretches between two zeros that were no
    frame; what was under way when the stream began is not one of them, nor are zeros in a row.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.damaged = 0
        self._rest = b""
        self._synchronised = False

    def feed(self, data: bytes) -> Packets:
        """The packets (n, 32) whose last byte is in ``data``; the rest waits for more."""
        *stretches, rest = (self._rest + data).split(DELIMITER)
        # a longer one is no frame however it goes on: what waits is bounded
        self._rest = rest[: STUFFED_BYTES + 1]
        packets = []
        for stretch in stretches:
            packet = _packet_of(stretch)
            if packet is not None:
                packets.append(packet)
            elif stretch and self._synchronised:
                self.damaged += 1
            self._synchronised = True
        self.frames += len(packets)
        return as_packets(b"".join(packets))


def _stuff(block: bytes) -> bytes:
    """COBS of at most 253 bytes, and the delimiter: each zero becomes the way to the next."""
    parts = block.split(DELIMITER)
    return b"".join(bytes((len(part) + 1,)) + part for part in parts) + DELIMITER


def _packet_of(stretch: bytes) -> bytes | None:
    """The packet in what stood between two zeros, or None if it is no sound frame."""
    if len(stretch) != STUFFED_BYTES:
        return None
    block = bytearray(stretch)
    at = 0
    while at < STUFFED_BYTES:
        step = block[at]
        block[at] = 0
        at += step
    if at != STUFFED_BYTES:
        return None
    packet, checksum = block[1 : 1 + PACKET_BYTES], block[1 + PACKET_BYTES :]
    if crc16(packet) != int.from_bytes(checksum, "little"):
        return None
    return bytes(packet)


# The bridge's USB interface: what its firmware declares and the host expects.
#
# A full-speed device with one vendor interface. Alternate setting 0 has no endpoint and reserves
# nothing on the bus; setting 1 has one isochronous IN endpoint of 64 bytes every 1 ms frame, which
# carries 0, 1 or 2 whole telemetry packets.


VENDOR_ID, PRODUCT_ID = 0x0483, 0x5741
INTERFACE, ALTERNATE = 0, 1
ENDPOINT = 0x81
FRAME_PACKETS = 2
USB_FRAME_BYTES = FRAME_PACKETS * PACKET_BYTES
FRAME_S = 1e-3
FRAME_NS = 1_000_000
