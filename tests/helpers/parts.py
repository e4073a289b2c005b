"""The two parts of the suite (``--part short|long``): ``tests/long_tests.txt`` lists the long one.

A line names a file, a class or a test; what stands behind ``#`` is a comment. A file that is
listed whole is not even imported for the short part.
"""

import re
from pathlib import Path

TESTS = Path(__file__).parents[1]
LONG = TESTS / "long_tests.txt"


def pytest_addoption(parser):
    parser.addoption(
        "--part",
        choices=["short", "long"],
        help="the tests of five minutes, or those that tests/long_tests.txt lists; else all",
    )


def pytest_ignore_collect(collection_path, config):
    if config.getoption("--part") == "short" and _name(collection_path) in listed():
        return True
    return None


def pytest_collection_modifyitems(config, items):
    part = config.getoption("--part")
    if part is None:
        return
    long = listed()
    kept = [item for item in items if is_long(item.nodeid, long) == (part == "long")]
    left = [item for item in items if is_long(item.nodeid, long) != (part == "long")]
    config.hook.pytest_deselected(items=left)
    items[:] = kept


def is_long(node, long):
    """Whether a test, or what it belongs to, is listed. ``node``: pytest's name for it."""
    name = node.removeprefix("tests/")
    places = [name, name.partition("[")[0]]
    while "::" in places[-1]:
        places.append(places[-1].rpartition("::")[0])
    return not long.isdisjoint(places)


def listed(file=LONG):
    """What the list names, without ``tests/``."""
    lines = (re.sub(r"(^|\s)#.*", "", line).strip() for line in file.read_text().splitlines())
    return {line for line in lines if line}


def _name(path):
    return path.relative_to(TESTS).as_posix() if path.is_relative_to(TESTS) else None
