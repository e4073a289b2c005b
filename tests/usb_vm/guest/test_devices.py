"""``devices`` on a machine that really has the bridge on its bus."""

import os
import subprocess
import sys
import time

import usb.core
import usb.util

from groundstation.cli.devices import usb_devices

BRIDGE = "0483:5741"
PATIENCE_S = 60.0


def listed():
    rows, problem = usb_devices(BRIDGE)
    assert problem == ""
    return rows


def rows_when(count):
    """The bus has told of a cable after a moment only."""
    deadline = time.monotonic() + PATIENCE_S
    while len(rows := listed()) != count:
        assert time.monotonic() < deadline, rows
        time.sleep(0.05)
    return rows


def test_the_bridge_is_listed_from_plug_to_unplug_and_says_when_it_is_taken(bridge):
    assert listed() == []  # hubs are not of interest
    bridge.plug()
    (row,) = rows_when(1)
    assert (row["name"], row["link"], row["usable"], row["why"]) == (BRIDGE, "usb", True, "")
    assert "bridge" in row["description"]
    assert "VM1" in row["description"]

    device = usb.core.find(idVendor=0x0483, idProduct=0x5741)
    usb.util.claim_interface(device, 0)
    (row,) = listed()
    assert not row["usable"]
    assert "in use" in row["why"]
    usb.util.dispose_resources(device)
    assert listed()[0]["usable"]

    bridge.unplug()
    assert rows_when(0) == []


def test_a_user_without_permission_is_told_of_the_rule(bridge):
    bridge.plug()
    rows_when(1)
    program = (
        "import os, usb.core\n"
        "from groundstation.cli.devices import usb_devices\n"
        "import groundstation.links.usb, libusb_package, usb.backend.libusb1\n"
        "os.setgid(65534); os.setuid(65534)\n"
        f"((row,), problem) = usb_devices({BRIDGE!r})\n"
        "print(row['usable'], row['why'])\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=dict(os.environ)
    )
    assert result.stdout.startswith("False no permission for /dev/bus/usb/"), result
    assert "groundstation install udev --print" in result.stdout
    bridge.unplug()
