"""How the suite is run: its two parts, what fails a run in CI beside a failing test, and what each
test costs. A pytest plugin, and a program: ``make test-durations``.

The lists of ``tests/`` name tests: a line is a file, a folder or a node id; ``#`` begins a reason.

``long_tests.txt``: the long part (``--part short|long``), where no limit holds. A file that is
listed whole is not even imported for the short part.
``heavy_tests.txt``: over the limit, and in the short part all the same; a reason is due.
``allowed_skips.txt``: may be skipped; a reason is due.
``allowed_second_tries.txt``: is run once more where it fails, and named where it then passes; a
reason is due. Nothing in ``ONE_TRY`` may stand there: a race in it must end the run.

Where ``CI=true``, a skip, a slow test or a second try that no list names fails the run, and so does
every other test that fails once, but for HeldUpError, which measured that the machine held a
program up (``tests/support/waiting.py``).
"""

import json
import os
import sys
import time
from collections import defaultdict
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
LONG_PROCESSOR_S, LONG_WALL_S = 1.0, 3.0
"""From here on a test is listed as long: half of what CI allows a test that is not, so that a busy
machine does not decide."""
SHARED_PROCESSOR_S = 2.0
"""A file whose tests share what took longer to make is listed whole: whichever of them comes first
pays for it, in both parts if both have one."""
TESTS = Path(__file__).parents[1]
HEADER = """\
# The long part of the suite: `make test` leaves these out, `make test-all` and CI run them.
# Written by `make test-durations`: each computes for a second or waits for three. A heavy test that
# must stay in the short part stands in heavy_tests.txt, with its reason.
tests/usb_vm  # in a virtual machine, by make test-usb
tests/local  # on recordings that may not be published
"""
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def pytest_addoption(parser):
    parser.addoption(
        "--part",
        choices=["short", "long"],
        help="the tests of five minutes, or those that tests/long_tests.txt lists; else all",
    )
    parser.addoption("--durations-to", metavar="FILE", help="write what each test took, as JSON")


def pytest_configure(config):
    register, judges = config.pluginmanager.register, not hasattr(config, "workerinput")
    if os.environ.get("CI") == "true":
        register(_Measure(), "ci-measure")
        register(_SecondTries(config.rootpath / "tests"), "ci-second-tries")
        if judges:  # workers measure, who started them judges
            register(_Judge(config.rootpath / "tests"), "ci-limits")
    if path := config.getoption("--durations-to"):
        register(_Durations(), "durations")
        if judges:
            register(_Writer(path), "durations-to")


# -- the lists --------------------------------------------------------------------------------


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


# -- the parts --------------------------------------------------------------------------------


def pytest_ignore_collect(collection_path, config):
    if config.getoption("--part") == "short":
        listed = names(config.rootpath / "tests" / "long_tests.txt", reasons=False)
        if collection_path.is_relative_to(config.rootpath):
            return collection_path.relative_to(config.rootpath).as_posix() in listed or None
    return None


def pytest_collection_modifyitems(config, items):
    part = config.getoption("--part")
    if part is None:
        return
    listed = names(config.rootpath / "tests" / "long_tests.txt", reasons=False)
    left = {item for item in items if named(item.nodeid, listed) != (part == "long")}
    config.hook.pytest_deselected(items=list(left))
    items[:] = [item for item in items if item not in left]


# -- CI ---------------------------------------------------------------------------------------


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


# -- durations --------------------------------------------------------------------------------


class _Durations:
    """Wall and processor time of each test, and of what was set up for it."""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        item.user_properties.append(("durations begun", (time.monotonic(), processor_s())))
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item):
        report = yield
        wall_s, computed_s = dict(item.user_properties)["durations begun"]
        now = (time.monotonic() - wall_s, processor_s() - computed_s)
        if report.when == "setup":
            item.user_properties.append(("setup took", now[1]))
        if report.when == "teardown":
            took = (*now, dict(item.user_properties)["setup took"])
            report.user_properties.append(("took", took))
        return report


class _Writer:
    """Collects what the workers report."""

    def __init__(self, path):
        self.path, self.took = path, {}

    def pytest_runtest_logreport(self, report):
        if took := dict(report.user_properties).get("took"):
            names = ("wall_s", "cpu_s", "setup_cpu_s")
            self.took[report.nodeid] = {
                name: round(value, 3) for name, value in zip(names, took, strict=True)
            }

    def pytest_sessionfinish(self):
        with open(self.path, "w") as file:
            json.dump(self.took, file, indent=0, sort_keys=True)


def long_tests(took, heavy):
    """What the list names, of {node: times}: whole files where all of their tests are long."""
    shared, by_file = defaultdict(float), defaultdict(dict)
    for node, times in took.items():
        file = node.partition("::")[0]
        shared[file] = max(shared[file], times["setup_cpu_s"])
    for node, times in took.items():
        file = node.partition("::")[0]
        long = times["cpu_s"] >= LONG_PROCESSOR_S or times["wall_s"] >= LONG_WALL_S
        long = long or shared[file] >= SHARED_PROCESSOR_S
        by_file[file][node] = long and not named(node, heavy)
    for file, tests in sorted(by_file.items()):
        if all(tests.values()):
            yield file
        else:
            yield from sorted(node for node, long in tests.items() if long)


if __name__ == "__main__":
    measured = json.loads(Path(sys.argv[1]).read_text())
    lines = long_tests(measured, names(TESTS / "heavy_tests.txt"))
    (TESTS / "long_tests.txt").write_text(HEADER + "".join(f"{line}\n" for line in lines))
