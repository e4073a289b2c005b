"""What a craft's address leads through, by whichever of its names a dongle is given."""

import pytest

from groundstation.links.command import both_names, is_software, ways_of

SERIALS = ("5CC6CC66B8", "e7a0b1c2d3")


@pytest.mark.parametrize(
    ("dongle", "names"),
    [
        ("0", {"dongle 0", "dongle 5CC6CC66B8"}),
        ("01", {"dongle 1", "dongle E7A0B1C2D3"}),
        ("5cc6cc66b8", {"dongle 0", "dongle 5CC6CC66B8"}),
        ("E7A0B1C2D3", {"dongle 1", "dongle E7A0B1C2D3"}),
        ("2", {"dongle 2"}),  # not plugged in yet
        ("0123456789", {"dongle 0123456789"}),
    ],
)
def test_a_dongle_has_its_number_and_its_serial_number(dongle, names):
    assert both_names(dongle, SERIALS) == names


def test_links_without_one_lead_through_none():
    links = "udp://127.0.0.1:19850", "stand-in", "usb", "serial:/dev/ttyUSB0", ""
    assert ways_of(links) == {link: set() for link in links}
    radio = "radio://71/80/2M/E7E7E7E7E7"
    ways = ways_of(["usb://0", radio])
    assert ways["usb://0"] == {"cable 0"}
    assert "dongle 71" in ways[radio]


@pytest.mark.parametrize(
    ("uri", "software"),
    [
        ("udp://127.0.0.1:19850", True),
        ("udp://127.3.2.1:19850", True),
        ("udp://localhost:19850", True),
        ("software:crazyflie21", True),
        ("udp://192.0.2.1:2390", False),  # an ESP-Drone, say
        ("udp://127.0.0.1.example.org:2390", False),
        ("udp://[::1]:2390", False),
        ("udp://128.0.0.1:1", False),
        ("udp://:1", False),
        ("radio://0/80/2M/E7E7E7E7E7", False),
        ("usb://0", False),
        ("daemon", False),
        ("", False),
    ],
)
def test_only_a_craft_of_this_machine_is_taken_for_software(uri, software):
    assert is_software(uri) is software
