"""The two parts of the suite (``--part short|long``): ``tests/long_tests.txt`` lists the long one.

A file that is listed whole is not even imported for the short part.
"""

from support.ci_limits import named, names


def pytest_addoption(parser):
    parser.addoption(
        "--part",
        choices=["short", "long"],
        help="the tests of five minutes, or those that tests/long_tests.txt lists; else all",
    )


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
    wanted = [named(item.nodeid, listed) == (part == "long") for item in items]
    left = [item for item, kept in zip(items, wanted, strict=True) if not kept]
    config.hook.pytest_deselected(items=left)
    items[:] = [item for item, kept in zip(items, wanted, strict=True) if kept]
