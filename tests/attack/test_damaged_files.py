"""Files of every format cut, repeated, shuffled and with columns dropped: an answer or a line in
the program's own words, never those of Python or of a library.

``FUZZ_FILES`` says how many variants (a thousand); each is made anew from the name of its file and
its number, which a failure names.
"""

import os
import struct
from collections import Counter

import pytest

from groundstation.recording import csv_file
from groundstation.recording.ulog_file import MAGIC
from support.fuzzing import answer, plotted, seeded, variant
from support.small_files import field_files, small_files

COUNT = int(os.environ.get("FUZZ_FILES", "1000"))
FIRST = int(os.environ.get("FUZZ_FIRST", "0"))
"""Number of the first variant: where a longer run goes on."""
TOLD = 12
CONVERTED, FITTED, MAPPED, RECOVERED, ASKED, PLOTTED = 11, 97, 13, 17, 19, 7
"""One in so many variants is converted as well, fitted, read by a map, recovered, asked for its
columns, opened on the page."""


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    return small_files(tmp_path_factory.mktemp("sources")) | field_files()


def commands(number, file, folder):
    """What is done with a variant: looked at, and in turn the rest."""
    yield "inspect", file
    if number % ASKED == 0:
        yield "convert", file, "--map"
    if number % PLOTTED == 0:
        yield ("page",)
    if number % CONVERTED == 0:
        end = ("mcap", "csv", "parquet", "csv --physical")[number // CONVERTED % 4]
        name, *more = end.split()
        yield "convert", file, folder / f"made.{name}", *more
    if number % MAPPED == 0:
        columns = ("cfclient", "betaflight", "nanodrone", "px4", "ros2")[number // MAPPED % 5]
        yield "inspect", file, "--columns", columns, "--json"
    if number % RECOVERED == 0:
        yield "recover", file, "-o", folder / "recovered.mcap"
    if number % FITTED == 0:
        yield "fit", "body", file, "--vehicle", "crazyflie21", "-o", folder / "model.json"


def test_every_small_file_is_read_before_it_is_damaged(tmp_path):
    for name, path in small_files(tmp_path).items():
        said, wrong = answer("inspect", path)
        assert not wrong, name
        assert "verdict" in said or name in ("ours.parquet", "unknown.parquet"), (name, said)


def test_what_no_reader_expected_is_found_here_and_told_to_no_user(tmp_path, monkeypatch):
    def fail(path, **_):
        raise ValueError("zip() argument 2 is longer than argument 1")

    monkeypatch.setattr(csv_file, "read_csv", fail)
    (tmp_path / "log.csv").write_text("t,x\n1,2\n")
    said, wrong = answer("inspect", tmp_path / "log.csv")
    assert "a reader met what it did not expect: ValueError: zip()" in wrong
    assert "log.csv: no table that this program can read" in said
    assert "zip" not in said


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", [b"x", b"A"])
def test_a_ulog_that_ends_within_a_message_comes_to_an_end(kind, tmp_path):
    """pyulog 1.3 steps back to before such a message, for ever."""
    file = tmp_path / "log.ulg"
    file.write_bytes(MAGIC + b"\1" + bytes(8) + struct.pack("<H", 20000) + kind + b"abc")
    said, wrong = answer("inspect", file)
    assert not wrong
    assert "no known map fits its series" in said


@pytest.mark.timeout(300 + COUNT // 4)
@pytest.mark.filterwarnings("ignore::ResourceWarning")  # libraries leave files open
def test_no_damaged_file_is_answered_in_the_words_of_python(sources, tmp_path):
    names = sorted(sources)
    found, first = Counter(), {}
    for number in range(FIRST, FIRST + COUNT):
        name = names[number % len(names)]
        file = tmp_path / f"damaged{sources[name].suffix}"
        variant(sources[name], seeded(name, number), file)
        for words in commands(number, file, tmp_path):
            _, wrong = plotted(file) if words[0] == "page" else answer(*words)
            if wrong:
                kind = wrong.rpartition("(")[2] if "(" in wrong else wrong[:60]
                found[kind] += 1
                first.setdefault(kind, f"{name}, number {number}, {words[0]}: {wrong}")
        for made in tmp_path.iterdir():
            made.unlink()
    told = [f"{times} times, {first[kind]}" for kind, times in found.most_common(TOLD)]
    assert not told, "\n".join([f"{sum(found.values())} of {COUNT}", *told])
