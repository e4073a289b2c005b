"""What fails a run in CI beside a failing test: a skip, or a slow test, that no list names; and
which failing test has a second try.

Where ``CI=true``, the lists of ``tests/`` say what may be otherwise. A line is a file, a folder or
a node id; ``#`` begins its reason.

``allowed_skips.txt``: may be skipped; a reason is due.
``heavy_tests.txt``: over the limit, and in the short suite all the same; a reason is due.
``long_tests.txt``: in the long suite, where no limit holds.
``allowed_second_tries.txt``: is run once more where it fails, and named where it then passes; a
reason is due. Nothing in ``ONE_TRY`` may stand there: a race in it must end the run.

Every other test that fails once fails the run, but for HeldUpError, which measured that the machine
held a program up (``tests/support/waiting.py``).
"""

import os
from contextlib import suppress
from pathlib import Path

import pytest

LIMIT_S = 2.0
"""Of processor time in a test's own call: what the test's process and all that it started computed.
Wall time would blame a test for a busy machine. What only waits costs nothing here."""
FAILS_S = 3 * LIMIT_S
"""From here on the run fails, below it is told only: the first test that needs something made once,
a fit say, pays for those after it, and which test is the first depends on the workers."""
PROPERTY = "processor_s"
ONE_TRY = ("tests/safety", "tests/service", "tests/attack", "tests/learn")
"""Who may move a motor, what the daemon promises, and who gets in."""
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def pytest_configure(config):
    if os.environ.get("CI") != "true":
        return
    config.pluginmanager.register(_Measure(), "ci-measure")
    config.pluginmanager.register(_SecondTries(config.rootpath / "tests"), "ci-second-tries")
    if not hasattr(config, "workerinput"):  # workers measure, who started them judges
        config.pluginmanager.register(_Judge(config.rootpath / "tests"), "ci-limits")


def names(path, reasons=True):
    """What a list names: node id, file or folder -> reason. No file, no names.

    Raises pytest.UsageError where a reason is due and is missing.
    """
    found = {}
    lines = path.read_text().splitlines() if path.exists() else []
    for number, line in enumerate(lines, 1):
        name, _, reason = (part.strip() for part in line.partition("#"))
        if name and reasons and not reason:
            raise pytest.UsageError(f"{path}:{number}: {name} has no reason; add one behind a #")
        if name:
            found[name] = reason
    return found


def named(node_id, listed):
    """Whether a list names this test, its file, or a folder that it is in."""
    return any(
        node_id == name or (node_id.startswith(name) and (node_id[len(name)] in ":[/"))
        for name in (one.rstrip("/") for one in listed)
    )


def processor_s():
    """s that this process, what it started, and what has ended of that, have computed so far."""
    total_s, left = 0.0, [os.getpid()]
    while left:
        pid = left.pop()
        with suppress(OSError):  # it has ended
            text = Path(f"/proc/{pid}/stat").read_text()
            # utime, stime, cutime, cstime: fields 14 to 17, counted behind the program's name
            total_s += sum(map(int, text.rpartition(")")[2].split()[11:15])) / _TICKS_PER_S
            for thread in os.listdir(f"/proc/{pid}/task"):
                with suppress(OSError):
                    started = Path(f"/proc/{pid}/task/{thread}/children").read_text()
                    left += map(int, started.split())
    return total_s


class _Measure:
    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_call(self, item):
        before_s = processor_s()
        try:
            return (yield)
        finally:
            item.user_properties.append((PROPERTY, processor_s() - before_s))


class _SecondTries:
    def __init__(self, folder):
        path = folder / "allowed_second_tries.txt"
        self._listed = names(path)
        for name in self._listed:
            if named(name, ONE_TRY):
                raise pytest.UsageError(f"{path}: {name} may have no second try")

    def pytest_collection_modifyitems(self, items):
        for item in items:
            if named(item.nodeid, self._listed):  # the mark is pytest-rerunfailures'
                item.add_marker(pytest.mark.flaky(reruns=1, only_rerun=[]))


class _Judge:
    def __init__(self, folder):
        self._skips = names(folder / "allowed_skips.txt")
        self._slow = {
            **names(folder / "heavy_tests.txt"),
            **names(folder / "long_tests.txt", reasons=False),
        }
        self._faults, self._slower, self._again = {}, {}, {}

    def pytest_collectreport(self, report):
        """A file may skip itself while it is imported."""
        self._judge_skip(report)

    def pytest_runtest_logreport(self, report):
        self._judge_skip(report)
        if report.outcome == "rerun":
            crash = getattr(report.longrepr, "reprcrash", None)
            self._again[report.nodeid] = str(crash.message if crash else report.longrepr)
        took_s = dict(report.user_properties).get(PROPERTY, 0.0)
        if report.when == "call" and took_s > LIMIT_S and not named(report.nodeid, self._slow):
            told = self._faults if took_s > FAILS_S else self._slower
            told[report.nodeid] = (
                f"{took_s:.1f} s of processor time, and neither long_tests.txt nor heavy_tests.txt "
                f"names it (limit {LIMIT_S:g} s)"
            )

    def _judge_skip(self, report):
        expected_failure = hasattr(report, "wasxfail")
        if report.skipped and not expected_failure and not named(report.nodeid, self._skips):
            *_, why = report.longrepr
            self._faults[report.nodeid] = f"skipped, and allowed_skips.txt does not name it: {why}"

    def pytest_sessionfinish(self, session):
        if self._faults and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter):
        if self._faults:
            terminalreporter.section("not allowed in CI", red=True, bold=True)
        for node_id, fault in self._faults.items():
            terminalreporter.write_line(f"CI: {node_id}: {fault}", red=True)
        for node_id, fault in self._again.items():
            terminalreporter.write_line(f"run again: {node_id}: {fault[:300]}", yellow=True)
        for node_id, fault in self._slower.items():
            terminalreporter.write_line(f"slow: {node_id}: {fault}", yellow=True)
