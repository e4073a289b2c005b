"""CI fails for what no list allows: a skip, a slow test, a second try."""

import os
import re
import sys
import time

import pytest

from support import ROOT
from support.programs import Program, run_program
from support.suite import named, names, processor_s

LIMIT_S = 0.3
CONFTEST = f"from support import suite\nsuite.LIMIT_S = suite.FAILS_S = {LIMIT_S}\n"
TESTS = """
import sys, time
from subprocess import run
import pytest

COMPUTE = "from time import process_time as s; end_s = s() + 0.35\\nwhile s() < end_s: pass"

def test_quick():
    pass

def test_waits():
    time.sleep(0.4)

def test_computes():
    exec(COMPUTE, {})

def test_lets_compute():
    run([sys.executable, "-c", COMPUTE], check=True)

@pytest.mark.parametrize("what", ["one", "two"])
def test_skips(what):
    pytest.skip(f"no {what}")

@pytest.mark.xfail(reason="known")
def test_known():
    raise AssertionError
"""


@pytest.fixture
def suite(tmp_path):
    """A small suite with its lists; gives what makes it run: (options, CI) -> finished process."""
    folder = tmp_path / "tests"
    folder.mkdir()
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    (folder / "conftest.py").write_text(CONFTEST)
    (folder / "test_small.py").write_text(TESTS)

    def run(*options, ci="true", **lists):
        for name, text in lists.items():
            (folder / f"{name}.txt").write_text(text)
        environment = {
            **os.environ,
            "CI": ci,
            "PYTHONPATH": str(ROOT / "tests"),
            "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",  # they take longer than the tests
        }
        plugins = ["-p", "support.suite", "-p", "xdist.plugin", "-p", "no:cacheprovider"]
        return run_program(
            [sys.executable, "-m", "pytest", *plugins, *options], cwd=tmp_path, env=environment
        )

    return run


def told(done):
    """Which tests the run was failed for: name -> fault."""
    lines = [line for line in done.stdout.splitlines() if line.startswith("CI: ")]
    return {line.split(": ")[1].partition("::")[2]: line for line in lines}


ALL = ["test_computes", "test_lets_compute", "test_skips[one]", "test_skips[two]"]


def test_skips_and_long_computing_that_no_list_names_fail_the_run_each_with_its_reason(suite):
    done = suite()
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout
    faults = told(done)
    assert sorted(faults) == ALL
    assert re.search(r"0\.[34] s of processor time", faults["test_computes"])
    assert "skipped" in faults["test_skips[two]"]
    assert "no two" in faults["test_skips[two]"]


def test_workers_are_judged_as_one_process_is(suite):
    done = suite(
        *("-n", "1", "-k", "computes or skips"),
        allowed_skips="tests/test_small.py::test_skips[one]  # it has no one\n",
    )
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout
    assert sorted(told(done)) == ["test_computes", "test_skips[two]"]


def test_what_the_lists_name_passes(suite):
    done = suite(
        allowed_skips="tests/test_small.py::test_skips  # it has nothing\n",
        heavy_tests="tests/test_small.py::test_computes  # nothing less shows it\n",
        long_tests="tests/test_small.py::test_lets_compute\n",
    )
    assert (done.returncode, told(done)) == (0, {}), done.stdout


def test_a_file_that_skips_itself_fails_the_run(suite, tmp_path):
    (tmp_path / "tests" / "test_whole.py").write_text(
        "import pytest\npytest.skip('no library', allow_module_level=True)\n"
    )
    done = suite("tests/test_whole.py", "tests/test_small.py::test_quick")
    assert done.returncode == 1
    assert "CI: tests/test_whole.py: skipped" in done.stdout
    assert "no library" in done.stdout


AGAIN = ("-p", "pytest_rerunfailures", "--reruns", "3", "--only-rerun", "HeldUpError")
RACE = "tests/test_race.py::test_race"


@pytest.fixture
def race(suite, tmp_path):
    """The small suite with a test that passes the second time, and one that never does."""
    (tmp_path / "tests" / "test_race.py").write_text(
        "RUNS = []\n"
        "def test_race():\n    RUNS.append(1)\n    assert len(RUNS) > 1, 'too early'\n"
        "def test_broken():\n    assert False\n"
    )
    return suite


def test_a_listed_test_has_a_second_try_and_is_named_and_any_other_failure_fails_the_run(race):
    assert race(*AGAIN, RACE).returncode == 1
    listed = {"allowed_second_tries": "tests/test_race.py  # a browser in real time\n"}
    done = race(*AGAIN, RACE, **listed)
    assert done.returncode == 0, done.stdout
    assert f"run again: {RACE}: AssertionError: too early" in done.stdout
    assert race(*AGAIN, "tests/test_race.py", **listed).returncode == 1
    assert race(*AGAIN, RACE, ci="").returncode == 1  # at a desk a race shows at once


@pytest.mark.parametrize("folder", ["safety", "service", "attack", "learn"])
def test_no_list_gives_a_second_try_to_what_keeps_people_from_harm(suite, folder):
    name = f"tests/{folder}/test_any.py::test_any"
    done = suite("-k", "quick", allowed_second_tries=f"{name}  # it is slow\n")
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert f"{name} may have no second try" in done.stderr


def test_nobody_but_ci_is_held_to_the_lists(suite):
    done = suite("-k", "quick or skips", ci="")
    assert (done.returncode, told(done)) == (0, {}), done.stdout


def test_a_list_is_refused_where_a_reason_is_missing(suite):
    done = suite("-k", "quick", heavy_tests="# heavy ones\n\ntests/test_small.py::test_quick\n")
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert "heavy_tests.txt:3: tests/test_small.py::test_quick has no reason" in done.stderr


def test_a_line_names_a_test_a_file_or_a_folder_and_nothing_that_only_begins_like_it():
    file = "tests/links/test_usb.py"
    test = f"{file}::test_a[1]"
    for name in (test, f"{file}::test_a", file, "tests/links", "tests/links/"):
        assert named(test, [name]), name
    for name in (f"{file}::test", "tests/link", "links", test + "[2]"):
        assert not named(test, [name]), name


@pytest.mark.parametrize(
    "name", ["allowed_skips", "heavy_tests", "long_tests", "allowed_second_tries"]
)
def test_what_the_lists_name_is_there(name):
    for node_id in names(ROOT / "tests" / f"{name}.txt", reasons=name != "long_tests"):
        path, *within = node_id.partition("[")[0].split("::")
        assert (ROOT / path).exists(), node_id
        # the outermost: what is inside a class may be inherited
        assert all(f" {one}(" in (ROOT / path).read_text() for one in within[:1]), node_id


def test_processor_time_counts_what_is_started_and_not_what_waits():
    before_s = processor_s()
    time.sleep(0.3)
    assert processor_s() - before_s < 0.2
    compute = "import time\nwhile time.process_time() < 0.3: pass\nprint(flush=True); input()"
    with Program([sys.executable, "-c", compute], stdin=-1, stdout=-1) as running:
        running.stdout.readline()
        assert processor_s() - before_s > 0.28  # still there
        running.communicate(b"\n")
    assert processor_s() - before_s > 0.28  # ended
