"""Inside the virtual machine only: the host runs these through ``test_usb_vm.py``."""

import os
import sys
from pathlib import Path

import pytest

IN_VM = "GROUNDSTATION_USB_VM" in os.environ
collect_ignore_glob = [] if IN_VM else ["test_*.py"]
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[2]))


@pytest.fixture(scope="session")
def flight(tmp_path_factory):
    """Packets without loss on the radio: every frame of the bus is full."""
    from emulated_bridge import OUT, unpacked

    return unpacked(OUT / "sound_flight.npz", tmp_path_factory.mktemp("flight"))


@pytest.fixture
def bridge(flight):
    """A bridge, not plugged in yet."""
    from emulated_bridge import EmulatedBridge

    with EmulatedBridge(flight) as bridge:
        yield bridge
