import pytest
from programs import run_program

from firmware_sim.craft import StandIn
from firmware_sim.settings import StandInSettings
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch


@pytest.fixture
def small_disk(tmp_path):
    """Makes a file system of so many bytes."""
    folder = tmp_path / "disk"

    def make(size):
        folder.mkdir()
        mount = run_program(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder])
        if mount.returncode:
            pytest.skip("mounting a small tmpfs needs root and a kernel that allows it")
        return folder

    yield make
    if folder.is_mount():
        run_program(["umount", folder], check=True)


@pytest.fixture(scope="session", autouse=True)
def compiled():
    """Compiles the stand-in and the decoder where no cache has them, outside any test's time."""
    craft = StandIn(StandInSettings())
    packets, arrival_s = craft.advance(2.5)
    decode_all(RawBatch(packets, (arrival_s * 1e9).astype("int64")))
