"""``devices`` through the installed command, on what this machine really has."""

import json
import os
import pty
import subprocess
import sys

import pytest
import usb.core
import usb.util
from serial.tools.list_ports import comports

from groundstation.cli.devices import port_row, usb_devices
from support.daemons import in_process, require_failure
from support.programs import Program, run_program


@pytest.fixture
def terminal():
    """The path of a pseudo-terminal that nobody has open at that end."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    yield path
    os.close(master)


def test_devices_lists_the_ports_of_this_machine_in_json_and_in_words():
    result = in_process("devices", "--json")
    assert result.returncode == 0, result.stderr
    listed = json.loads(result.stdout)
    ports = [row["name"] for row in listed["devices"] if row["kind"] == "serial"]
    assert ports == sorted(port.device for port in comports())
    for row in listed["devices"]:
        assert set(row) == {"kind", "name", "link", "description", "usable", "why"}
        assert row["usable"] == (row["why"] == "")
    lines = in_process("devices").stdout.splitlines()
    for row in listed["devices"]:
        (line,) = [line for line in lines if line.startswith(row["kind"]) and row["name"] in line]
        assert (f"usable: --link {row['link']}" if row["usable"] else row["why"]) in line
    nothing = "no serial port and no telemetry bridge is plugged in"
    assert (nothing in lines) == all(row["link"] is None for row in listed["devices"])


def test_devices_without_libusb_still_lists_the_ports_and_says_what_is_missing():
    hide = (
        "import sys, usb.backend.libusb1 as backend\n"
        "sys.modules['libusb_package'] = None\n"
        "backend.get_backend = lambda *a, **k: None\n"
        "import usb.backend.libusb0, usb.backend.openusb\n"
        "usb.backend.libusb0.get_backend = usb.backend.openusb.get_backend = lambda *a, **k: None\n"
        "sys.argv[1:] = ['devices']\n"
        "from groundstation.cli.main import main\n"
        "main()\n"
    )
    result = run_program([sys.executable, "-c", hide])
    assert result.returncode == 0, result.stderr
    assert "libusb was not found: install" in result.stdout


def test_a_free_port_is_usable_and_says_how(terminal):
    row = port_row(terminal, "Some adapter")
    assert row["usable"]
    assert row["link"] == f"serial:{terminal}"
    assert row["description"] == "Some adapter"


def test_a_port_that_a_program_has_open_names_it(terminal):
    holder = Program(
        [sys.executable, "-c", f"f = open({terminal!r}, 'rb', 0); print(flush=True); input()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with holder:
        holder.stdout.readline()
        row = port_row(terminal)
        holder.communicate(b"\n")
    assert not row["usable"]
    assert f"in use by process {holder.pid} (" in row["why"]


def test_a_port_without_permission_tells_which_group_to_join(terminal):
    if os.geteuid() != 0:
        pytest.skip("only root can become a user without permission")
    os.chmod(terminal, 0o600)
    os.chown(terminal, -1, 1)
    program = (
        "import os, sys\n"
        "from groundstation.cli.devices import port_row\n"
        "import groundstation.links.serial\n"
        "os.setgid(65534); os.setuid(65534)\n"
        "print(port_row(sys.argv[1])['why'])\n"
    )
    result = run_program([sys.executable, "-c", program, terminal], check=True)
    assert result.stdout.startswith("permission denied; join its group with 'sudo usermod -aG")


@pytest.mark.parametrize(
    ("path", "why"), [("/dev/ttyNOWHERE", "No such file or directory"), ("/", "no serial port")]
)
def test_what_is_no_port_is_not_usable(path, why):
    assert port_row(path)["why"] == why


class Device:
    """What pyusb's ``find`` would give: there is no USB here (the virtual machine has it)."""

    bus, address, bDeviceClass = 250, 250, 0  # noqa: N815 - pyusb's name
    manufacturer, product, serial_number = "maker", None, None

    def __init__(self, vendor, product):
        self.idVendor, self.idProduct = vendor, product


@pytest.mark.parametrize(
    ("refusal", "usable", "why"),
    [
        (None, True, ""),
        (usb.core.USBError("Resource busy", errno=16), False, "in use"),
        (usb.core.USBError("Access denied", errno=13), False, "cannot be opened: Access denied"),
    ],
)
def test_the_bridge_comes_first_and_is_usable_or_why_not(monkeypatch, refusal, usable, why):
    hub = Device(0x1D6B, 2)
    hub.bDeviceClass = 9

    def claim(device, interface):
        if refusal:
            raise refusal

    give(monkeypatch, [hub, Device(0x046D, 1), Device(0x0483, 0x5741)])
    monkeypatch.setattr(usb.util, "claim_interface", claim)
    (bridge, mouse), problem = usb_devices("0483:5741")
    assert problem == ""
    assert (bridge["name"], bridge["link"], bridge["usable"]) == ("0483:5741", "usb", usable)
    assert why in bridge["why"]
    assert bridge["description"] == "maker"
    assert (mouse["name"], mouse["link"], mouse["usable"]) == ("046d:0001", None, False)
    assert mouse["why"] == "not a telemetry bridge"


def give(monkeypatch, devices):
    monkeypatch.setattr(usb.core, "find", lambda **_: iter(devices))
    monkeypatch.setattr(usb.util, "claim_interface", lambda device, interface: None)
    monkeypatch.setattr(usb.util, "dispose_resources", lambda device: None)


def test_the_bridge_is_the_one_that_was_asked_for(monkeypatch):
    give(monkeypatch, [Device(0x0483, 0x5741), Device(0x1209, 0xABCD)])
    rows, _ = usb_devices("1209:ABCD")
    assert [(row["name"], row["link"]) for row in rows] == [
        ("1209:abcd", "usb"),
        ("0483:5741", None),
    ]


def test_a_wrong_configuration_is_one_line():
    assert "nowhere.toml" in require_failure(in_process("devices", "--config", "nowhere.toml"))


def test_a_bus_that_cannot_be_read_is_told(monkeypatch):
    def refuse(**_):
        raise usb.core.USBError("Input/output error", errno=5)

    monkeypatch.setattr(usb.core, "find", refuse)
    rows, problem = usb_devices("0483:5741")
    assert rows == []
    assert "USB cannot be listed" in problem
