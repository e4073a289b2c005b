"""Compiled code is kept by the content of what it was made of, in a folder of the user's alone."""

import os
import shutil
import tempfile
from pathlib import Path

import pytest

from groundstation import compiled
from groundstation.compiled import CACHE, cache_folder, source_stamp

PRIVATE = 0o700


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """A program of four files: a kernel, what it imports, and one that it does not."""
    package = tmp_path / "groundstation"
    (package / "laws").mkdir(parents=True)
    (package / "kernels.py").write_text(
        "from groundstation.numbers import (\n    GRAVITY,  # m/s^2\n)\n"
        "from groundstation import laws\n"
    )
    (package / "numbers.py").write_text("GRAVITY = 9.81\n")
    (package / "laws" / "drag.py").write_text("from groundstation.laws.base import law\n")
    (package / "laws" / "base.py").write_text("law = 1\n")
    (package / "other.py").write_text("import groundstation.kernels\n")
    monkeypatch.setattr(compiled, "ROOT", tmp_path)
    forget()
    yield package
    forget()


def forget():
    """What was read of sources, as a new program would begin."""
    source_stamp.cache_clear()
    compiled._imported.cache_clear()


@pytest.mark.parametrize("changed", ["kernels.py", "numbers.py", "laws/drag.py", "laws/base.py"])
def test_a_change_in_what_a_kernel_is_made_of_compiles_it_anew(sources, changed):
    before = source_stamp(sources / "kernels.py")
    (sources / changed).write_text((sources / changed).read_text() + "MORE = 1\n")
    forget()
    assert source_stamp(sources / "kernels.py") != before


def test_a_change_elsewhere_compiles_nothing(sources):
    before = source_stamp(sources / "kernels.py")
    (sources / "other.py").write_text("")
    forget()
    assert source_stamp(sources / "kernels.py") == before


def test_a_copy_of_the_program_shares_what_is_compiled(sources, monkeypatch):
    before = source_stamp(sources / "kernels.py")
    copy = sources.parents[1] / "copy"
    shutil.copytree(sources.parent, copy)
    monkeypatch.setattr(compiled, "ROOT", copy)
    forget()
    assert source_stamp(copy / "groundstation" / "kernels.py") == before


@pytest.fixture
def homes(tmp_path, monkeypatch):
    """A user's cache folder, one for temporary files, and no choice made yet."""
    monkeypatch.delenv(CACHE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "users"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    cache_folder.cache_clear()
    yield tmp_path
    cache_folder.cache_clear()


def test_the_users_cache_folder_is_made_for_the_user_alone(homes):
    assert cache_folder() == homes / "users" / "groundstation" / "kernels"
    assert cache_folder().parent.stat().st_mode & 0o777 == PRIVATE


def test_a_choice_of_the_user_stands(homes, monkeypatch):
    monkeypatch.setenv(CACHE, "/somewhere")
    assert cache_folder() == Path("/somewhere")


def test_where_the_users_folder_cannot_be_written_a_private_temporary_one_serves(
    homes, monkeypatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    assert cache_folder() == homes / f"groundstation-{os.getuid()}" / "kernels"
    assert cache_folder().parent.stat().st_mode & 0o777 == PRIVATE


@pytest.mark.parametrize("how", ["open to all", "a link", "a file"])
def test_a_temporary_folder_that_others_can_write_is_not_trusted(homes, monkeypatch, how):
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    taken = homes / f"groundstation-{os.getuid()}"
    if how == "open to all":
        taken.mkdir()
        taken.chmod(0o777)
    elif how == "a link":
        (homes / "elsewhere").mkdir(mode=PRIVATE)
        taken.symlink_to(homes / "elsewhere")
    else:
        taken.touch(0o600)
    folder = cache_folder().parent
    assert folder != taken
    assert folder.stat().st_mode & 0o777 == PRIVATE


def test_what_nobody_used_for_long_is_removed_and_the_rest_stays(tmp_path):
    for name, days in (("old", compiled.KEPT_DAYS + 1), ("used", 1)):
        kept = tmp_path / name
        kept.mkdir()
        (kept / "kernel.nbc").write_bytes(b"code")
        used_s = (kept.stat().st_mtime) - days * 86_400
        os.utime(kept / "kernel.nbc", (used_s, used_s))
        os.utime(kept, (used_s, used_s))
    compiled._remove_unused(tmp_path)
    assert [one.name for one in tmp_path.iterdir()] == ["used"]
