"""The bridge as a device on the USB: found by its ids, claimed and let go, by pyusb."""

from __future__ import annotations

import contextlib
import errno
import re
from typing import Any

from groundstation.errors import BadInputError, LinkError
from groundstation.links.usb_ring import IsoRing
from groundstation.telemetry.packet import ALTERNATE, ENDPOINT, INTERFACE, PRODUCT_ID, VENDOR_ID
from groundstation.telemetry.packet import USB_FRAME_BYTES as FRAME_BYTES

DEFAULT_DEVICE = f"{VENDOR_ID:04x}:{PRODUCT_ID:04x}"
PERMISSION_HELP = (
    "install the rule with 'groundstation install udev --print | "
    "sudo tee /etc/udev/rules.d/70-groundstation.rules', then plug the device in again"
)

_ISOCHRONOUS = 1


class BridgeDevice:
    """A telemetry bridge by vendor and product id.

    ids: ``VID:PID`` in hexadecimal. serial: of one among several; empty for the first found.
    """

    def __init__(self, ids: str, serial: str) -> None:
        self._vendor, self._product = parse_ids(ids)
        self._name, self._serial = ids.lower(), serial
        self._backend: Any = None

    def __str__(self) -> str:
        return f"{self._name} with serial number {self._serial}" if self._serial else self._name

    def claim(self) -> Any:
        """Find the device and make it stream; None when it is not there. Blocks."""
        import usb.core
        import usb.util

        try:
            for device in self.find():
                serial = self._serial
                if serial and usb.util.get_string(device, device.iSerialNumber) != serial:
                    usb.util.dispose_resources(device)
                    continue
                try:
                    _select(device)
                except BaseException:
                    usb.util.dispose_resources(device)
                    raise
                return device
        except usb.core.USBError as error:
            if error.errno in (errno.ENODEV, errno.ENOENT):
                return None  # it went away while it was being opened
            raise LinkError(f"USB device {self}: {_explain(error)}") from error
        except (NotImplementedError, ValueError) as error:
            # pyusb: no access to the language list or the strings
            raise LinkError(f"USB device {self}: {error}; {PERMISSION_HELP}") from error
        return None

    def find(self) -> list[Any]:
        """Devices with these ids, by pyusb; its library is loaded the first time. Blocks."""
        import libusb_package
        import usb.core
        from usb.backend import libusb1

        if self._backend is None:
            self._backend = libusb1.get_backend(find_library=libusb_package.find_library)
        if self._backend is None:
            raise LinkError(
                "libusb is not usable here: reinstall with 'pip install libusb-package'"
            )
        found = usb.core.find(
            find_all=True, backend=self._backend, idVendor=self._vendor, idProduct=self._product
        )
        return list(found)


def parse_ids(device: str) -> tuple[int, int]:
    """Vendor and product id of ``VID:PID``. Raises BadInputError for anything else."""
    match = re.fullmatch(r"([0-9a-fA-F]{4}):([0-9a-fA-F]{4})", device)
    if match is None:
        raise BadInputError(
            f"configuration [usb] device {device!r}: give VID:PID, for example {DEFAULT_DEVICE}"
        )
    return int(match[1], 16), int(match[2], 16)


def release(ring: IsoRing | None, device: Any) -> None:
    """Stop the stream and let go of the device, whether or not it is still there. Blocks."""
    import usb.core
    import usb.util

    if ring is not None:
        ring.free()
    with contextlib.suppress(usb.core.USBError):
        device.set_interface_altsetting(INTERFACE, 0)
    usb.util.dispose_resources(device)


def _select(device: Any) -> None:
    """Claim the interface and switch its endpoint on. Raises LinkError when it is no bridge."""
    import usb.core
    import usb.util

    try:
        configuration = device.get_active_configuration()
    except usb.core.USBError:
        device.set_configuration()
        configuration = device.get_active_configuration()
    setting = usb.util.find_descriptor(
        configuration, bInterfaceNumber=INTERFACE, bAlternateSetting=ALTERNATE
    )
    endpoint = setting and usb.util.find_descriptor(setting, bEndpointAddress=ENDPOINT)
    isochronous = endpoint and usb.util.endpoint_type(endpoint.bmAttributes) == _ISOCHRONOUS
    if not isochronous or endpoint.wMaxPacketSize != FRAME_BYTES:
        raise LinkError(
            f"USB device {device.idVendor:04x}:{device.idProduct:04x} is no telemetry bridge: it "
            f"needs isochronous endpoint 0x{ENDPOINT:02x} of {FRAME_BYTES} bytes in alternate "
            f"setting {ALTERNATE}; set [usb] device to another one"
        )
    usb.util.claim_interface(device, INTERFACE)
    device.set_interface_altsetting(INTERFACE, ALTERNATE)


def _explain(error: Any) -> str:
    if error.errno == errno.EACCES:
        return f"no permission; {PERMISSION_HELP}"
    if error.errno == errno.EBUSY:
        return "in use by another program; stop that first"
    return f"{error.strerror}; unplug it and plug it in again"
