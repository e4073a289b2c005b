"""Packets on a byte stream: COBS with a checksum and a zero byte at the end of each frame.

A frame is 36 bytes: the packet and its CRC-16/CCITT-FALSE (low byte first, as every field of
the packet), 34 bytes, stuffed by COBS into 35 that hold no zero, then a zero. So a zero in the
stream is always the end of a frame, and a reader that starts anywhere, or finds damage, is in
step again with the next one.

COBS: S. Cheshire and M. Baker, "Consistent overhead byte stuffing", IEEE/ACM Transactions on
Networking 7(2), 1999. CRC: polynomial 0x1021, initial value 0xFFFF, not reflected; the check
value of "123456789" is 0x29B1.
"""

from __future__ import annotations

import binascii

from groundstation.telemetry.packet import PACKET_BYTES, Packets, as_packets

CRC_BYTES = 2
CRC_INITIAL = 0xFFFF
STUFFED_BYTES = 1 + PACKET_BYTES + CRC_BYTES
"""Packet and checksum after COBS, which adds one byte to anything shorter than 254."""
DELIMITER = b"\0"
FRAME_BYTES = STUFFED_BYTES + len(DELIMITER)
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
