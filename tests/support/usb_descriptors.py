"""What the bridge's firmware says of itself on the bus (USB 2.0, chapter 9)."""

from __future__ import annotations

import struct

from groundstation.telemetry.packet import ALTERNATE, ENDPOINT, INTERFACE, PRODUCT_ID, VENDOR_ID
from groundstation.telemetry.packet import USB_FRAME_BYTES as FRAME_BYTES

INTERVAL = 1
MAX_POWER_MA = 100
CONTROL_BYTES = 64
ENGLISH = 0x0409


def device_descriptor(vendor_id: int = VENDOR_ID, product_id: int = PRODUCT_ID) -> bytes:
    """The 18 bytes of USB 2.0 table 9-8: strings 1 maker, 2 product, 3 serial number."""
    return struct.pack(
        "<BBHBBBBHHHBBBB",
        18, 1, 0x0200, 0, 0, 0, CONTROL_BYTES, vendor_id, product_id, 0x0100, 1, 2, 3, 1,
    )  # fmt: skip


def configuration_descriptor() -> bytes:
    """The configuration with its interface, both settings and the endpoint (USB 2.0 9.6.3)."""
    body = (
        _interface(0, endpoints=0)
        + _interface(ALTERNATE, endpoints=1)
        + struct.pack("<BBBBHB", 7, 5, ENDPOINT, 1, FRAME_BYTES, INTERVAL)
    )
    head = struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 1, 1, 0, 0x80, MAX_POWER_MA // 2)
    return head + body


def string_descriptor(text: str, index: int) -> bytes:
    """A string, or for index 0 the one language they are in."""
    content = struct.pack("<H", ENGLISH) if index == 0 else text.encode("utf-16-le")
    return struct.pack("<BB", 2 + len(content), 3) + content


def _interface(alternate: int, endpoints: int) -> bytes:
    return struct.pack("<BBBBBBBBB", 9, 4, INTERFACE, alternate, endpoints, 0xFF, 0, 0, 0)
