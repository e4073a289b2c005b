"""Imports point the way docs/architecture.md says."""

import ast
import re
from graphlib import CycleError, TopologicalSorter

import pytest

import groundstation
from groundstation.dynamics.registry import EFFECTS
from support import ROOT

TEXT = (ROOT / "docs" / "architecture.md").read_text()
ROWS = re.findall(r"^\| `(\w+)` \| ([^|]*)\| ([^|]*)\| (\d+) \|$", TEXT, re.MULTILINE)
PACKAGES = {name: (what, may) for name, what, may, _ in ROWS}
BUDGETS = {name: int(lines) for name, _, _, lines in ROWS}
SMALL = {path.stem for path in (ROOT / "groundstation").glob("*.py")} - {"__init__"}
PURE = {name for name, (what, _) in PACKAGES.items() if what.strip().endswith("pure")}
OUTSIDE = {"asyncio", "http", "socket", "subprocess", "threading", "serial", "usb", "rerun"} | {
    *("multiprocessing", "shutil", "tempfile", "urllib"),
}
"""What touches the world: no business of a pure package."""
PARTS_MOST, MODULE_LINES, FUNCTION_LINES = 30, 1000, 100
"""A function of two screens."""
LONG_KERNELS = {
    "firmware_sim/plant.py: derivative",
    "groundstation/control/kernels.py: cascade_run",
    "groundstation/prediction/kernels.py: observe",
    "groundstation/twin/kernels.py: score",
}
"""Loops over rows that numba compiles: what they carry from one row to the next is a dozen local
numbers, and each function that took them would be inlined again, at the price of its compiling."""


def sources(package):
    folder = ROOT / package if package == "firmware_sim" else ROOT / "groundstation" / package
    return sorted(folder.rglob("*.py"))


def imported(path):
    """Every module that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            yield node.module or ""
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def ours(path):
    """The packages of ours that a file imports; of the package itself only the version."""
    for module in imported(path):
        top, _, rest = module.partition(".")
        if top == "groundstation" and rest:
            yield rest.partition(".")[0]
        elif top == "firmware_sim":
            yield top


def allowed(package):
    may = PACKAGES[package][1]
    if "everything" in may:
        return set(PACKAGES)
    names = set(re.findall(r"\w+", re.sub(r"\([^)]*\)", "", may))) & set(PACKAGES)
    return names | (PURE if "all pure packages" in may else set())


def test_the_table_has_every_package():
    folders = {path.parent.name for path in (ROOT / "groundstation").glob("*/__init__.py")}
    assert folders | {"firmware_sim"} == set(PACKAGES)


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_a_package_imports_what_its_row_says(package):
    for path in sources(package):
        strange = set(ours(path)) - allowed(package) - SMALL - {package}
        assert not strange, f"{path.relative_to(ROOT)} imports {sorted(strange)}"


@pytest.mark.parametrize("package", sorted(PURE))
def test_a_pure_package_does_not_touch_the_world(package):
    for path in sources(package):
        touched = OUTSIDE & {module.partition(".")[0] for module in imported(path)}
        assert not touched, f"{path.relative_to(ROOT)} imports {sorted(touched)}"


def test_small_modules_import_nothing_of_ours_but_each_other():
    for name in SMALL:
        assert set(ours(ROOT / "groundstation" / f"{name}.py")) <= SMALL, name


def test_only_commands_use_the_public_names_which_lead_everywhere():
    for path in sources(""):
        if path.parent.name != "cli":
            taken = set(named(path)) & {f"groundstation.{name}" for name in groundstation.__all__}
            assert not taken, f"{path.relative_to(ROOT)} takes {sorted(taken)}"


def test_no_way_leads_back_to_the_package_where_it_began():
    """``cli``, which may import everything, is imported by nobody."""
    arrows = {package: allowed(package) - {package} for package in PACKAGES}
    assert not any("cli" in arrows[package] for package in PACKAGES)
    assert_no_circle(arrows)


def test_no_way_leads_back_to_the_module_where_it_began():
    """Wherever in a module the import stands."""
    modules = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): path
        for package in ("", "firmware_sim")
        for path in sources(package)
        if path.name != "__init__.py"
    }
    arrows = {name: set(named(path)) & set(modules) for name, path in modules.items()}
    assert_no_circle(arrows)


def named(path):
    """What a file imports, modules and what it takes from them alike, by full name."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def assert_no_circle(arrows):
    try:
        TopologicalSorter(arrows).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_there_are_at_most_30_packages_and_top_level_modules():
    assert len(PACKAGES) + len(SMALL) <= PARTS_MOST


def test_a_file_has_at_most_1000_lines():
    files = [path for package in ("", "firmware_sim") for path in sources(package)]
    long = [str(path.relative_to(ROOT)) for path in files if lines_of(path) > MODULE_LINES]
    assert not long


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_a_package_keeps_its_budget_of_lines(package):
    lines = sum(lines_of(path) for path in sources(package))
    assert lines <= BUDGETS[package], f"{lines} lines: give the reason in the package's row"


def lines_of(path):
    return len(path.read_text().splitlines())


def test_a_function_has_at_most_two_screens_unless_it_is_a_kernel():
    long = {
        f"{path.relative_to(ROOT)}: {node.name}": compiled(node)
        for package in ("", "firmware_sim")
        for path in sources(package)
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and node.end_lineno - node.lineno >= FUNCTION_LINES
    }
    assert set(long) == LONG_KERNELS
    assert all(long[name] for name in LONG_KERNELS)


def compiled(function):
    decorators = " ".join(ast.unparse(one) for one in function.decorator_list)
    return bool(re.search(r"\b(kernel|inner)\b", decorators))


def test_only_two_links_know_the_software_craft():
    knowing = [
        path.relative_to(ROOT / "groundstation").as_posix()
        for path in sources("")
        if "firmware_sim" in set(ours(path))
    ]
    assert sorted(knowing) == ["links/software_craft.py", "links/stand_in.py"]


@pytest.fixture(scope="module")
def spoken():
    """The strings of each file's code outside effects and thesis, without docstrings."""
    folder = ROOT / "groundstation"
    return {
        path.relative_to(folder): " ".join(strings(ast.parse(path.read_text())))
        for path in sorted(folder.rglob("*.py"))
        if path.parent.name not in ("effects", "thesis")
    }


def strings(tree):
    bodies = [node.body for node in ast.walk(tree) if isinstance(getattr(node, "body", None), list)]
    apart = {id(one.value) for body in bodies for one in body if isinstance(one, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in apart:
            yield node.value


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_an_effect_is_named_by_its_own_file_and_at_most_two_more(name, spoken):
    """The thesis, which finds chosen effects, names what it chooses."""
    word = re.compile(rf"\b{name}\b")
    named = [path for path, text in spoken.items() if word.search(text)]
    assert len(named) <= 2, named


FILES = [*sources(""), *sources("firmware_sim")]
REFERENCE = re.compile(r"``([\w/]+\.py|[a-z_]+\.[A-Za-z_]\w+)``")
OUTSIDE_NAMES = {"motor.m1", "kalman.dragB_x", "supervisor.info", "recording.folder"}
"""Of the craft's log and parameters, and of the configuration, that look like names in modules."""


def test_files_and_names_that_comments_point_to_are_there():
    known = {path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py")}
    modules = {}
    for path in FILES:
        modules.setdefault(path.stem, []).append(path.read_text())
    packages = {path.name for path in (ROOT / "groundstation").rglob("*") if path.is_dir()}
    lost = []
    for path in FILES:
        for named in REFERENCE.findall(path.read_text()):
            where, _, name = named.rpartition(".")
            if name == "py":
                there = any(f"/{one}".endswith(f"/{named}") for one in known)
            elif where in modules:
                there = any(re.search(rf"\b{name}\b", text) for text in modules[where])
            else:
                there = where not in packages or name in modules
            if not there and named not in OUTSIDE_NAMES:
                lost.append(f"{path.relative_to(ROOT)}: {named}")
    assert lost == []
