"""Running tests with a fault, each time in a process of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from bench.mutants.fault import ROOT, Fault
from bench.mutants.hook.sitecustomize import VARIABLE

HOOK = Path(__file__).with_name("hook")
TEST_S, WHOLE_S = 20, 600.0
"""What one test may take before it counts as failed, with a fault or without one: tests of the
short suite take a tenth of that. And what all tests of one run may take."""
TESTS_FAILED = 1
"""pytest's status where tests ran, and one failed at least."""


@dataclass(frozen=True)
class Outcome:
    """What the tests made of a fault; ``fault`` is None for the sources as they are.

    failed, passed: how many tests. status: pytest's, None where it did not end in time.
    log: what it printed.
    """

    fault: Fault | None
    status: int | None
    failed: int
    passed: int
    seconds: float
    log: str

    @property
    def is_good(self) -> bool:
        """Whether the fault was noticed; without one, whether all tests passed."""
        if self.fault is None:
            return self.status == 0
        return self.status == TESTS_FAILED and self.failed >= self.fault.least


def run_all(faults: Iterable[tuple[Fault | None, Sequence[str]]], jobs: int) -> Iterator[Outcome]:
    """Run tests beside each fault, some at a time; outcomes in order."""
    with ThreadPoolExecutor(jobs) as pool:
        yield from pool.map(lambda one: _tested(*one), list(faults))


def _tested(fault: Fault | None, tests: Sequence[str]) -> Outcome:
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutant-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        told, log = folder / "told.xml", folder / "log"
        options = ["-q", f"--timeout={TEST_S}", f"--basetemp={folder / 't'}", f"--junitxml={told}"]
        options += ["-p", "no:cacheprovider", "-p", "no:xdist"]
        with log.open("wb") as printed:
            process = subprocess.Popen(
                [sys.executable, "-m", "pytest", *options, *tests],
                cwd=ROOT, env=_environment(fault, folder), stdout=printed, stderr=printed,
                start_new_session=True,
            )  # fmt: skip
            try:
                status: int | None = process.wait(WHOLE_S)
            except subprocess.TimeoutExpired:
                status = None
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        failed, passed = _counted(told)
        text = log.read_text(errors="replace")
    return Outcome(fault, status, failed, passed, time.monotonic() - began_s, text)


def _environment(fault: Fault | None, folder: Path) -> dict[str, str]:
    changed = {
        "PYTHONPATH": f"{HOOK}{os.pathsep}{os.environ.get('PYTHONPATH', '')}",
        "TMPDIR": str(folder),
        "OPENBLAS_NUM_THREADS": "1",
    }
    if fault is not None:
        changed[VARIABLE] = fault.as_variable()
        if fault.is_compiled:  # what is kept of kernels goes by the files, where the fault is not
            changed["NUMBA_CACHE_DIR"] = str(folder / "numba")
    environment = {**os.environ, **changed}
    environment.pop("CI", None)  # its limits are another matter
    return environment


def _counted(told: Path) -> tuple[int, int]:
    """(tests that failed, tests that passed) of a report in JUnit's form."""
    if not told.exists():
        return 0, 0
    passed, failed = 0, set()
    for case in ElementTree.parse(told).getroot().iter("testcase"):
        name = case.get("classname"), case.get("name")
        if any(case.find(kind) is not None for kind in ("failure", "error")):
            failed.add(name)
        elif case.find("skipped") is None:
            passed += 1
    return len(failed), passed
