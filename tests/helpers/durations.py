"""What each test costs: a pytest plugin (``-p durations --durations-to FILE``).

Processor time is that of the worker and of the programs that it started and that have ended, so
that a busy machine changes it little; wall time stands beside it.
"""

import json
import os
import time

import pytest


def pytest_addoption(parser):
    parser.addoption("--durations-to", metavar="FILE", help="write what each test took, as JSON")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    begun = time.monotonic(), _processor_s()
    item.user_properties.append(("durations begun", begun))
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    report = yield
    if report.when == "teardown":
        wall_s, processor_s = dict(item.user_properties)["durations begun"]
        report.user_properties.append(
            ("took", (time.monotonic() - wall_s, _processor_s() - processor_s))
        )
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
            self.took[report.nodeid] = {"wall_s": round(took[0], 3), "cpu_s": round(took[1], 3)}

    def pytest_sessionfinish(self):
        with open(self.path, "w") as file:
            json.dump(self.took, file, indent=0, sort_keys=True)


def _processor_s():
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
