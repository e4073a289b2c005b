"""The table of faults is true, a fault gets in everywhere, and one that survives is told."""

import os
import re
import sys
from dataclasses import replace

import pytest

from bench.mutants.fault import Fault
from bench.mutants.run import HOOK, Outcome
from bench.mutants.table import FAULTS
from support import ROOT
from support.ci_limits import named, names
from support.programs import run_program

EVERY = [fault for group in FAULTS.values() for fault in group]
TICK = next(fault for fault in EVERY if fault.name == "tick")


@pytest.mark.parametrize("fault", EVERY, ids=lambda fault: fault.name)
def test_a_fault_names_text_and_tests_that_are_there_and_leaves_a_program(fault):
    assert fault.untrue() == ""
    compile(fault.path.read_text().replace(fault.old, fault.new), fault.file, "exec")


def test_every_fault_has_a_name_of_its_own():
    assert len({fault.name for fault in EVERY}) == len(EVERY)


def test_the_tests_that_should_notice_are_in_the_short_suite():
    long = names(ROOT / "tests" / "long_tests.txt", reasons=False)
    assert not [(fault.name, test) for fault in EVERY for test in fault.tests if named(test, long)]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"old": "no such text"}, "occurs 0 times"),
        ({"old": "import"}, r"occurs \d+ times"),
        ({"file": "groundstation/nowhere.py"}, "not there any more"),
        ({"tests": ("tests/bench/test_mutants.py::test_of_nothing",)}, "no test"),
    ],
)
def test_a_row_that_is_not_true_any_more_says_what_to_do(changes, says):
    assert re.search(f"^tick: .*{says}", replace(TICK, **changes).untrue())


def test_a_program_that_a_test_starts_has_the_fault_and_the_file_does_not():
    before = TICK.path.read_bytes()
    ask = "from groundstation.telemetry.packet import TICK_S; print(TICK_S)"
    environment = {**os.environ, "PYTHONPATH": str(HOOK)}
    told = [
        run_program([sys.executable, "-c", ask], cwd=ROOT, env={**environment, **more}, check=True)
        for more in ({}, {"GROUNDSTATION_MUTANT": TICK.as_variable()}, {})
    ]
    sound = f"{73e-6 / 72}\n"
    assert [one.stdout for one in told] == [sound, "1e-06\n", sound]
    assert TICK.path.read_bytes() == before


RUN = """
import sys
from dataclasses import replace
from bench.mutants import __main__, table
tick = next(one for one in table.FAULTS["units and signs"] if one.name == "tick")
test = ("tests/telemetry/test_packet.py::test_a_sample_is_two_milliseconds_of_ticks",)
harmless = replace(tick, name="harmless", old='"\\""One count', new='"\\""A count', tests=test)
__main__.FAULTS = {"units": (replace(tick, tests=test), harmless)}
sys.exit(__main__.main())
"""


def test_a_fault_that_no_test_notices_fails_the_command():
    done = run_program([sys.executable, "-c", RUN, "--jobs", "1"], cwd=ROOT)
    assert done.returncode == 1, done.stderr
    assert "no fault: every test passes (1)" in done.stdout
    assert "noticed  by 1 of 1" in done.stdout
    assert done.stdout.endswith("1 of 2 faults were noticed; not: harmless\n")


@pytest.mark.parametrize(
    ("status", "failed", "noticed"),
    [(1, 2, True), (1, 1, False), (2, 2, False), (None, 0, False)],
)
def test_a_fault_counts_as_noticed_where_tests_ran_and_enough_of_them_failed(
    status, failed, noticed
):
    fault = replace(TICK, least=2)
    assert isinstance(fault, Fault)
    assert Outcome(fault, status, failed, 3, 1.0, "").is_good is noticed


def test_without_a_fault_every_test_has_to_pass():
    assert Outcome(None, 0, 0, 3, 1.0, "").is_good
    assert not Outcome(None, 1, 1, 3, 1.0, "").is_good
