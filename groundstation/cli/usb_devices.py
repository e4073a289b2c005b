"""USB devices by VID:PID as pyusb sees them, and whether the bridge among them can be used."""

from __future__ import annotations

import errno
import os
from typing import Any

from groundstation.telemetry.packet import INTERFACE

CRAZYFLIE = {"1915:7777": "Crazyradio", "35f0:bad2": "Crazyradio 2", "0483:5740": "Crazyflie"}
"""What reaches a stock craft."""
HUB = 0x09
"""Device class of hubs, which nobody looks for."""


def usb_devices(bridge: str) -> tuple[list[dict[str, Any]], str]:
    """Every device of the bus, bridges first, and why there are none if they cannot be listed.

    bridge: VID:PID of the telemetry bridge.
    Keys of a row: kind, name (VID:PID), link (what to give to --link, None where there is no
    telemetry), description, usable, why (not).
    """
    import usb.core

    try:
        found = [
            device
            for device in usb.core.find(find_all=True, backend=_backend())
            if device.bDeviceClass != HUB
        ]
    except usb.core.NoBackendError:
        return [], "libusb was not found: install libusb-1.0, or 'pip install libusb-package'"
    except (usb.core.USBError, OSError) as error:
        return [], f"USB cannot be listed: {error}"
    rows = [_row(device, bridge.lower()) for device in found]
    return sorted(rows, key=lambda row: (row["link"] is None, row["name"])), ""


def _backend() -> Any:
    """The libusb that comes with libusb-package, as the link uses it, else the system's."""
    from usb.backend import libusb1

    try:
        from libusb_package import find_library
    except ImportError:
        return libusb1.get_backend()
    return libusb1.get_backend(find_library=find_library)


def _row(device: Any, bridge: str) -> dict[str, Any]:
    identity = f"{device.idVendor:04x}:{device.idProduct:04x}"
    why = _why_not(device) if identity == bridge else "not a telemetry bridge"
    if identity in CRAZYFLIE:
        why = f"{CRAZYFLIE[identity]}: what it reaches is listed as craft"
    return {
        "kind": "usb",
        "name": identity,
        "link": "usb" if identity == bridge else None,
        "description": _description(device),
        "usable": not why,
        "why": why,
    }


def _why_not(device: Any) -> str:
    import usb.core
    import usb.util

    node = f"/dev/bus/usb/{device.bus:03d}/{device.address:03d}"
    if os.path.exists(node) and not os.access(node, os.R_OK | os.W_OK):
        from groundstation.links.usb import PERMISSION_HELP

        return f"no permission for {node}; {PERMISSION_HELP}"
    try:
        usb.util.claim_interface(device, INTERFACE)
    except usb.core.USBError as error:
        if error.errno == errno.EBUSY:
            return "in use: stop the program that has claimed it"
        return f"cannot be opened: {error.strerror or error}"
    finally:
        usb.util.dispose_resources(device)
    return ""


def _description(device: Any) -> str:
    """Maker and product; without permission their strings cannot be read."""
    import usb.core
    import usb.util

    try:
        names = (device.manufacturer, device.product, device.serial_number)
    except (usb.core.USBError, ValueError, NotImplementedError):
        return ""
    finally:
        usb.util.dispose_resources(device)
    return " ".join(name for name in names if name)
