import pytest


@pytest.fixture
def small_disk(small_disk):
    """A file system of 1 MiB."""
    return small_disk("1m")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "flight.mcap"
