import subprocess

import pytest


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 1 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", folder], capture_output=True
    )
    if mount.returncode:
        pytest.skip("mounting a small tmpfs needs root and a kernel that allows it")
    yield folder
    subprocess.run(["umount", folder], check=True)
