"""Homes that cannot be written, and folders for compiled code that somebody else made first."""

import os
import tempfile
from pathlib import Path

import pytest

from groundstation.kernel_cache import CACHE, provide_cache

NOWHERE = [Path("/proc/nowhere/cache"), Path("/dev/null/cache")]


@pytest.fixture
def shared(tmp_path, monkeypatch):
    """A folder for temporary files, and no cache chosen yet."""
    monkeypatch.setenv(CACHE, "")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_a_folder_that_works_is_chosen_and_named(shared):
    folder = provide_cache(NOWHERE)
    assert folder == shared / f"groundstation-{os.getuid()}" / "numba"
    assert os.environ[CACHE] == str(folder)
    assert folder.parent.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("how", ["open to all", "a link", "a file"])
def test_a_folder_that_others_can_write_is_not_trusted(shared, how):
    taken = shared / f"groundstation-{os.getuid()}"
    if how == "open to all":
        taken.mkdir()
        taken.chmod(0o777)
    elif how == "a link":
        (shared / "elsewhere").mkdir(mode=0o700)
        taken.symlink_to(shared / "elsewhere")
    else:
        taken.touch(0o600)
    folder = provide_cache(NOWHERE)
    assert folder.parent != taken
    assert folder.parent.stat().st_mode & 0o777 == 0o700


def test_where_the_usual_folders_work_nothing_is_changed(shared):
    assert provide_cache([shared / "not" / "made" / "yet"]) is None
    assert os.environ[CACHE] == ""


def test_a_choice_of_the_user_stands(shared, monkeypatch):
    monkeypatch.setenv(CACHE, "/somewhere")
    assert provide_cache(NOWHERE) is None
    assert os.environ[CACHE] == "/somewhere"
