import pytest
from programs import run_program


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 1 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = run_program(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", folder])
    if mount.returncode:
        pytest.skip("mounting a small tmpfs needs root and a kernel that allows it")
    yield folder
    run_program(["umount", folder], check=True)
