"""Tests of real flights that are not in the repository: nobody's machine may run them for weeks."""

import os
import sys

from support import ROOT
from support.programs import run_program


def test_the_tests_that_need_other_flights_still_import_what_they_test():
    folder = {"GROUNDSTATION_LOCAL_DATA": str(ROOT / "recordings")}
    collected = run_program(
        [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:xdist", "tests/local"],
        cwd=ROOT,
        env={**os.environ, **folder},
        timeout=120,
    )
    assert collected.returncode == 0, collected.stdout
    assert "test_local_identification.py" in collected.stdout
