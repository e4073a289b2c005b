"""What each test costs, and the list of long ones that follows from it (``make test-durations``).

As a pytest plugin (``-p durations --durations-to FILE``) it writes wall and processor time of each
test; as a program (``durations.py FILE``) it writes ``tests/long_tests.txt`` from that. Processor
time is that of the worker and of the programs that it started and that have ended.
"""

import json
import os
import sys
import time
from collections import defaultdict
from pathlib import Path

import pytest

LONG_PROCESSOR_S, LONG_WALL_S = 1.0, 3.0
"""From here on a test is listed: half of what CI allows a test that is not, so that a busy machine
does not decide."""
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


def pytest_addoption(parser):
    parser.addoption("--durations-to", metavar="FILE", help="write what each test took, as JSON")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    item.user_properties.append(("durations begun", (time.monotonic(), _processor_s())))
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    report = yield
    wall_s, processor_s = dict(item.user_properties)["durations begun"]
    now = (time.monotonic() - wall_s, _processor_s() - processor_s)
    if report.when == "setup":
        item.user_properties.append(("setup took", now[1]))
    if report.when == "teardown":
        report.user_properties.append(("took", (*now, dict(item.user_properties)["setup took"])))
    return report


def pytest_configure(config):
    if config.getoption("--durations-to") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Writer(config.getoption("--durations-to")))


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
    from support.ci_limits import named

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


def _processor_s():
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


if __name__ == "__main__":
    from support.ci_limits import names

    measured = json.loads(Path(sys.argv[1]).read_text())
    lines = long_tests(measured, names(TESTS / "heavy_tests.txt"))
    (TESTS / "long_tests.txt").write_text(HEADER + "".join(f"{line}\n" for line in lines))
