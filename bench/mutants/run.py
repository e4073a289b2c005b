"""Running tests with a fault: a fork of a process that has imported what takes long, each."""

from __future__ import annotations

import importlib
import json
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.mutants.fault import ROOT, Fault
from bench.mutants.hook.sitecustomize import VARIABLE, install

HOOK = Path(__file__).with_name("hook")
TEST_S, WHOLE_S = 20, 600.0
"""What one test may take before it counts as failed, with a fault or without one: tests of the
short suite take a tenth of that. And what all tests of one run may take."""
_LONG = (
    *("pytest", "hypothesis", "_hypothesis_pytestplugin", "numpy", "numba", "scipy.signal"),
    *("scipy.optimize", "mcap.reader", "starlette.routing", "typer", "uvicorn"),
)
TESTS_FAILED = 1
"""pytest's status where tests ran, and one failed at least."""


@dataclass(frozen=True)
class Outcome:
    """What the tests made of a fault; ``fault`` is None for the sources as they are.

    failed, passed: tests. status: pytest's, None where it did not end in time.
    log: what it printed.
    """

    fault: Fault | None
    status: int | None
    failed: list[str]
    passed: int
    seconds: float
    log: str

    @property
    def is_good(self) -> bool:
        """Whether the fault was noticed; without one, whether all tests passed."""
        if self.fault is None:
            return self.status == 0
        return self.status == TESTS_FAILED and len(self.failed) >= self.fault.least


def run_all(faults: Iterable[tuple[Fault | None, Sequence[str]]], jobs: int) -> Iterator[Outcome]:
    """Run tests beside each fault, some at a time; outcomes as they come."""
    _import_what_takes_long()
    left, running = list(faults)[::-1], []
    while left or running:
        while left and len(running) < jobs:
            running.append(_Fork(*left.pop()))
        time.sleep(0.02)
        for fork in [each for each in running if each.has_ended()]:
            running.remove(fork)
            yield fork.outcome()


def _import_what_takes_long() -> None:
    """Nothing of ours: it has to be imported with the fault in it."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for name in _LONG:
        importlib.import_module(name)


class _Fork:
    """Tests that run beside a fault."""

    def __init__(self, fault: Fault | None, tests: Sequence[str]) -> None:
        self._fault, self._began_s = fault, time.monotonic()
        self._folder = tempfile.TemporaryDirectory(prefix="mutant-", ignore_cleanup_errors=True)
        self._place = Path(self._folder.name)
        sys.stdout.flush()
        self._pid = os.fork()
        if self._pid == 0:
            try:
                _test(fault, tests, self._place)
            except BaseException:
                traceback.print_exc()
            finally:  # no way leads from here into what the parent does
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(0)

    def has_ended(self) -> bool:
        if os.waitpid(self._pid, os.WNOHANG)[0]:
            return True
        if time.monotonic() - self._began_s < WHOLE_S:
            return False
        with suppress(ProcessLookupError):
            os.killpg(self._pid, signal.SIGKILL)
        os.waitpid(self._pid, 0)
        return True

    def outcome(self) -> Outcome:
        seconds = time.monotonic() - self._began_s
        told = self._place / "told.json"
        nothing = {"status": None, "failed": [], "passed": 0}
        found = json.loads(told.read_text()) if told.exists() else nothing
        log = (self._place / "log").read_text(errors="replace")
        self._folder.cleanup()
        return Outcome(self._fault, **found, seconds=seconds, log=log)


@dataclass(eq=False)
class _Recorder:
    """A plugin of pytest: which tests failed."""

    path: Path
    failed: list[str] = field(default_factory=list)
    passed: int = 0

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed and report.nodeid not in self.failed:
            self.failed.append(report.nodeid)
        self.passed += report.when == "call" and report.passed

    def pytest_sessionfinish(self, exitstatus: int) -> None:
        """Not the process's status: what a failed test left open is one more fault behind this."""
        found = {"status": exitstatus, "failed": self.failed, "passed": self.passed}
        self.path.write_text(json.dumps(found))


def _test(fault: Fault | None, tests: Sequence[str], folder: Path) -> None:
    """In the fork."""
    import pytest

    os.setsid()
    os.chdir(ROOT)
    log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT, 0o600)
    for stream in (1, 2):
        os.dup2(log, stream)
    tempfile.tempdir = os.environ["TMPDIR"] = str(folder)
    os.environ.pop("CI", None)  # its limits are another matter
    os.environ["PYTHONPATH"] = f"{HOOK}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    if fault is not None:
        os.environ[VARIABLE] = fault.as_variable()
        install(fault.as_variable())
        if fault.is_compiled:
            _keep_kernels_apart(folder / "numba")
    # plain: what was imported before cannot be rewritten, and nobody reads these failures
    options = ["-q", "--assert=plain", f"--timeout={TEST_S}", f"--basetemp={folder / 't'}"]
    options += ["-p", "no:cacheprovider", "-p", "no:xdist"]
    pytest.main([*options, *tests], plugins=[_Recorder(folder / "told.json")])


def _keep_kernels_apart(folder: Path) -> None:
    """Numba's cache goes by the files on disk, where the fault is not."""
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    sys.modules["numba.core.config"].reload_config()  # type: ignore[attr-defined]
