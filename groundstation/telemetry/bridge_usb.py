"""The bridge's USB interface: what its firmware declares and the host expects.

A full-speed device with one vendor interface. Alternate setting 0 has no endpoint and reserves
nothing on the bus; setting 1 has one isochronous IN endpoint of 64 bytes every 1 ms frame, which
carries 0, 1 or 2 whole telemetry packets.
"""

from __future__ import annotations

from groundstation.telemetry.packet import PACKET_BYTES

VENDOR_ID, PRODUCT_ID = 0x0483, 0x5741
INTERFACE, ALTERNATE = 0, 1
ENDPOINT = 0x81
FRAME_PACKETS = 2
FRAME_BYTES = FRAME_PACKETS * PACKET_BYTES
FRAME_S = 1e-3
FRAME_NS = 1_000_000
