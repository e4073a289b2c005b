"""Settings for every test."""

import atexit
import os
import shutil
import signal
import sys
import tempfile

# Before numpy is there: its matrices are small here, and more threads spend their time waiting.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import HealthCheck, settings

from groundstation.allocator import keep_freed
from support.programs import run_program, start_guard

pytest_plugins = ["support.suite"]
# Byte code is kept: without it every worker reads and rewrites all test files anew, for minutes.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
keep_freed()  # as the command itself does

# What tests consent to is not remembered for whoever runs them, and tests run effects of their own.
os.environ.update(
    {
        name: tempfile.mkdtemp(prefix="groundstation-tests-")
        for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME")
    },
    GROUNDSTATION_TRUST_EFFECTS="1",
)
for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME"):
    atexit.register(shutil.rmtree, os.environ[name], ignore_errors=True)

# Under nohup, and in the background of a script, every program started here would keep on ignoring
# what the tests send it.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

start_guard()

# A deadline measures the machine, not the code, and examples may be slow on a loaded one.
# The same examples every time: some behaviour has stated odds (docs/telemetry.md), and a change
# must not be blamed for the draw.
settings.register_profile(
    "project",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("project")


def pytest_collection_modifyitems(config, items):
    """Files with a test that may take minutes, by its own limit, begin first: the last of them
    would hold one worker up when all others are done. Each worker starts with an equal stretch of
    the list (``--dist worksteal``), so each stretch begins with its share of them."""
    usual_s = float(config.getini("timeout") or "inf")
    slow = {item.path: [] for item in items if _limit_s(item, usual_s) > usual_s}
    rest = [item for item in items if item.path not in slow]
    for item in items:
        if item.path in slow:
            slow[item.path].append(item)
    workers = getattr(config, "workerinput", {}).get("workercount", 1)
    files, count, ordered = list(slow.values()), len(items), []
    for worker in range(workers):
        ordered += [item for file in files[worker::workers] for item in file]
        fill = max(count * (worker + 1) // workers - len(ordered), 0)
        ordered += rest[:fill]
        rest = rest[fill:]
    items[:] = ordered + rest


def _limit_s(item, usual_s):
    mark = item.get_closest_marker("timeout")
    return float(mark.args[0]) if mark is not None else usual_s


@pytest.fixture
def small_disk(tmp_path):
    """Makes a file system of so many bytes."""
    folder = tmp_path / "disk"

    def make(size):
        folder.mkdir()
        mount = run_program(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder])
        if mount.returncode:
            pytest.skip("mounting a small tmpfs needs root and a kernel that allows it")
        return folder

    yield make
    if folder.is_mount():
        run_program(["umount", folder], check=True)
