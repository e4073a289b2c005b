"""``groundstation devices``: what is plugged in, and whether it can be used."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from pathlib import Path
from typing import Any

import typer

from groundstation import BadInputError
from groundstation.cli.model_files import AS_JSON, answer
from groundstation.errors import TakenError
from groundstation.telemetry.packet import INTERFACE

# USB devices by VID:PID as pyusb sees them, and whether the bridge among them can be used.


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
    why = _why_not_open(device) if identity == bridge else "not a telemetry bridge"
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


def _why_not_open(device: Any) -> str:
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


def add_commands(app: typer.Typer) -> None:
    app.command("devices")(devices)


def devices(
    config: Path | None = typer.Option(None, help="TOML file whose \\[usb] names the bridge."),
    craft: bool = typer.Option(
        True, help="Look for craft by radio; not while another program flies one."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Serial ports, USB devices and the craft in reach: usable or why not.

    Example: [bold]groundstation devices[/bold]
    """
    from groundstation.service.config import load_config

    usb, problem = usb_devices(load_config(config).usb.device)
    found, unseen = craft_in_reach(usb) if craft else ([], "")
    rows = [*serial_ports(), *usb, *found]
    problem = "; ".join(filter(None, (problem, unseen)))
    lines = []
    for row in rows:
        state = f"usable: --link {row['link']}" if row["usable"] else row["why"]
        lines.append(f"{row['kind']:<8}{row['name']:<20}{state}")
        if row["description"]:
            lines.append(f"{'':<28}{row['description']}")
    if not any(row["link"] for row in rows):
        lines.append("no serial port and no telemetry bridge is plugged in")
    if problem:
        lines.append(f"usb     {problem}")
    answer(as_json, {"devices": rows, "usb_problem": problem or None}, lines)


def craft_in_reach(usb: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], str]:
    """Stock craft that answer a dongle or cable among ``usb``, and why they cannot be looked for.
    Keys as ``usb_devices``."""
    from groundstation.links.command import LOOKED_THROUGH, in_reach, ways_of
    from groundstation.service.craft_links import Dongles

    if not any(row["name"] in CRAZYFLIE for row in usb):
        return [], ""
    try:
        with contextlib.closing(Dongles()) as dongles:
            dongles.take(ways_of(LOOKED_THROUGH))
            found = in_reach()
    except (BadInputError, TakenError) as error:
        return [], str(error)
    rows = [
        {"kind": "craft", "name": uri, "link": uri, "description": "", "usable": True, "why": ""}
        for uri in found
    ]
    return rows, ""


def serial_ports() -> list[dict[str, Any]]:
    """Every serial port of the machine. Keys as ``usb_devices``."""
    from serial.tools.list_ports import comports

    return [
        port_row(port.device, port.description if port.description != "n/a" else "")
        for port in sorted(comports())
    ]


def port_row(path: str, description: str = "") -> dict[str, Any]:
    """One port, looked at without opening the line: opening would reset some boards."""
    why = _why_not(path)
    return {
        "kind": "serial",
        "name": path,
        "link": f"serial:{path}",
        "description": description,
        "usable": not why,
        "why": why,
    }


def _why_not(path: str) -> str:
    try:
        found = os.stat(path)
    except OSError as error:
        return error.strerror or str(error)
    if not stat.S_ISCHR(found.st_mode):
        return "no serial port"
    if not os.access(path, os.R_OK | os.W_OK):
        from groundstation.links.serial import permission_advice

        return permission_advice(path)
    owner = _owner(found.st_rdev)
    return f"in use by {owner}" if owner else ""


def _owner(device: int) -> str:
    """A process that has the port open, as far as this user may look."""
    for process in Path("/proc").glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):
            for handle in (process / "fd").iterdir():
                with contextlib.suppress(OSError):
                    found = handle.stat()
                    if stat.S_ISCHR(found.st_mode) and found.st_rdev == device:
                        name = (process / "comm").read_text().strip()
                        return f"process {process.name} ({name})"
    return ""
