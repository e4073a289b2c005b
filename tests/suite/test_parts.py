"""``make test`` runs the short part of the suite, ``make test-all`` both; a test is in one."""

import json
import sys

import pytest

from support import ROOT
from support.programs import run_program
from support.suite import LONG_PROCESSOR_S, LONG_WALL_S, SHARED_PROCESSOR_S, long_tests, names

LISTED = names(ROOT / "tests" / "long_tests.txt", reasons=False)
HEAVY = names(ROOT / "tests" / "heavy_tests.txt")
SUITE = """\
import pytest

@pytest.mark.parametrize("size", [1, 2])
def test_of_many_sizes(size): pass

def test_that_is_quick(): pass
"""


@pytest.fixture
def collected(tmp_path):
    """Names of the tests that a part of a small suite has: {part: names}."""
    tests = tmp_path / "tests"
    tests.mkdir()
    for name in ("test_one.py", "test_all_long.py"):
        (tests / name).write_text(SUITE)
    listed = ("tests/test_all_long.py", "tests/test_one.py::test_of_many_sizes[2]  # waits")
    (tests / "long_tests.txt").write_text("# why\n" + "\n".join(listed))
    command = [sys.executable, "-m", "pytest", "-q", "--collect-only", "-p", "no:cacheprovider",
               "-p", "support.suite", "--rootdir", tmp_path, "-c", "/dev/null", tests]  # fmt: skip

    def part(*options):
        said = run_program(
            [*command, *options],
            cwd=tmp_path,
            env={"PYTHONPATH": str(ROOT / "tests"), "PATH": "/usr/bin:/bin"},
            timeout=60,
        ).stdout
        return {line for line in said.splitlines() if "::" in line}

    return part


def test_each_test_is_in_one_part_and_both_are_the_whole(collected):
    short, long, everything = collected("--part", "short"), collected("--part", "long"), collected()
    assert short == {
        "tests/test_one.py::test_of_many_sizes[1]",
        "tests/test_one.py::test_that_is_quick",
    }
    assert long == everything - short
    assert len(everything) == 6


def test_what_computes_or_waits_for_long_is_listed_a_file_as_a_whole_where_all_do():
    quick = {"cpu_s": 0.1, "wall_s": 0.1, "setup_cpu_s": 0.0}
    slow, waits = quick | {"cpu_s": LONG_PROCESSOR_S}, quick | {"wall_s": LONG_WALL_S}
    took = {"a.py::one": quick, "a.py::two": slow, "b.py::one": slow, "b.py::two": waits}
    assert list(long_tests(took, heavy={})) == ["a.py::two", "b.py"]
    assert list(long_tests(took, heavy={"b.py::two": "safety"})) == ["a.py::two", "b.py::one"]


def test_a_file_whose_tests_share_what_takes_long_to_make_is_listed_but_for_what_must_stay():
    pays = {"cpu_s": 3.0, "wall_s": 3.0, "setup_cpu_s": SHARED_PROCESSOR_S}
    shares = {"cpu_s": 0.1, "wall_s": 0.1, "setup_cpu_s": 0.0}
    took = {"a.py::one": pays, "a.py::two": shares, "b.py::one": shares}
    assert list(long_tests(took, heavy={})) == ["a.py"]
    assert list(long_tests(took, heavy={"a.py::one": "safety"})) == ["a.py::two"]


def test_what_is_heavy_and_stays_in_the_short_part_is_not_in_the_long_one():
    assert not set(HEAVY) & set(LISTED), json.dumps(sorted(set(HEAVY) & set(LISTED)))
