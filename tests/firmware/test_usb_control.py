"""The bridge's answers on endpoint 0 beside those of the emulated bridge and of USB 2.0."""

import ctypes
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.telemetry.packet import ALTERNATE, ENDPOINT, INTERFACE
from support.firmware import UsbControl, firmware, octets
from support.usb_device import (
    UsbBridge,
    configuration_descriptor,
    device_descriptor,
    string_descriptor,
)

IDENTITY = bytes(range(0xA0, 0xAC))
SERIAL = IDENTITY.hex().upper()


class NoFlight:
    def advance(self, until_s):
        return np.empty((0, 32), np.uint8), np.empty(0)


class Device:
    """``bridge/usb_control.c``."""

    def __init__(self):
        self.control = UsbControl()
        firmware().usb_control_init(ctypes.byref(self.control), octets(IDENTITY))

    def ask(self, setup):
        size = firmware().usb_control_request(ctypes.byref(self.control), octets(setup))
        return None if size < 0 else bytes(self.control.answer[:size])


def setup(kind, request, value=0, index=0, length=0):
    return struct.pack("<BBHHH", kind, request, value, index, length)


KNOWN = st.builds(
    setup,
    st.sampled_from([0x00, 0x01, 0x02, 0x80, 0x81, 0x82]),
    st.sampled_from([0, 1, 6, 8, 9, 10, 11]),
    st.one_of(st.sampled_from([0, 1, 2, 0x100, 0x200, 0x300, 0x301, 0x302, 0x303, 0x304, 0x600]),
              st.integers(0, 65535)),
    st.one_of(st.sampled_from([0, 1, ENDPOINT, 0x0409]), st.integers(0, 65535)),
    st.one_of(st.sampled_from([0, 2, 9, 64, 255]), st.integers(0, 65535)),
)  # fmt: skip


@given(requests=st.lists(st.one_of(KNOWN, st.binary(min_size=8, max_size=8)), max_size=20))
def test_any_requests_get_the_answers_of_the_emulated_bridge(requests):
    """SET_ADDRESS apart, which a virtual host controller keeps to itself."""
    device, emulated = Device(), UsbBridge(NoFlight(), serial=SERIAL)
    for request in requests:
        if request[:2] != bytes([0, 5]):
            assert device.ask(request) == emulated.control(request, 0.0), request.hex(" ")


def test_a_host_that_finds_configures_and_listens_gets_what_the_usb_link_asks_for():
    device = Device()
    assert device.ask(setup(0x80, 6, 0x0100, 0, 64)) == device_descriptor()
    assert device.ask(setup(0x00, 5, 93)) == b""
    assert device.control.address == 93
    assert device.ask(setup(0x80, 6, 0x0200, 0, 9)) == configuration_descriptor()[:9]
    assert device.ask(setup(0x80, 6, 0x0200, 0, 255)) == configuration_descriptor()
    assert device.ask(setup(0x80, 6, 0x0303, 0x0409, 255)) == string_descriptor(SERIAL, 3)
    assert device.ask(setup(0x00, 9, 1)) == b""
    assert device.ask(setup(0x01, 11, ALTERNATE, INTERFACE)) == b""
    assert (device.control.configuration, device.control.alternate) == (1, ALTERNATE)
    assert device.ask(setup(0x01, 11, 0, INTERFACE)) == b""
    assert device.control.alternate == 0


def test_a_reset_of_the_bus_forgets_all_but_the_name():
    device = Device()
    for request in (setup(0, 5, 7), setup(0, 9, 1), setup(1, 11, ALTERNATE)):
        device.ask(request)
    firmware().usb_control_reset(ctypes.byref(device.control))
    control = device.control
    assert (control.address, control.configuration, control.alternate) == (0, 0, 0)
    assert control.serial.decode() == SERIAL


@pytest.mark.parametrize("value", [128, 0xFFFF])
def test_an_address_that_usb_does_not_have_is_stalled(value):
    device = Device()
    assert device.ask(setup(0, 5, value)) is None
    assert device.control.address == 0
