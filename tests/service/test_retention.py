"""Which recordings give way when there are too many: the oldest, one after the other."""

import os

import pytest

from groundstation.service.recording_manager import delete_oldest

NAMES = [f"2026-0{month}-01T10-00-00-000Z_usb.mcap" for month in range(1, 7)]
SIZE = 1000


@pytest.fixture
def folder(tmp_path):
    """Recordings of six months, put down in any order; a file's own time says nothing."""
    for age, name in enumerate(sorted(NAMES, key=lambda name: name[6])[::-1]):
        (tmp_path / name).write_bytes(bytes(SIZE))
        os.utime(tmp_path / name, (age, age))
    return tmp_path


@pytest.mark.parametrize("kept", range(len(NAMES) + 1))
def test_the_newest_stay_and_no_more_than_needed_is_deleted(folder, kept):
    deleted, stuck = delete_oldest(folder, kept * SIZE + SIZE // 2, set())
    assert (deleted, stuck) == (NAMES[: len(NAMES) - kept], [])
    assert sorted(os.listdir(folder)) == NAMES[len(NAMES) - kept :]


def test_what_is_present_stays_and_the_next_oldest_goes(folder):
    deleted, _ = delete_oldest(folder, 4 * SIZE, {NAMES[0], NAMES[2]})
    assert deleted == [NAMES[1], NAMES[3]]
