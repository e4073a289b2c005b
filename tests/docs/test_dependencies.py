"""docs/dependencies.md justifies what pyproject.toml asks for: all of it and nothing else."""

import ast
import re
import sys
import tomllib

from support import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
ASKED = [*PROJECT["dependencies"], *(one for some in EXTRAS.values() for one in some)]


def test_every_dependency_is_justified_and_every_row_is_a_dependency():
    text = (ROOT / "docs" / "dependencies.md").read_text()
    rows = re.findall(r"^\| ([\w.-]+) \|", text, re.MULTILINE)
    assert set(rows) - {"package"} == {re.split(r"[<>=]", one)[0] for one in ASKED}


def test_every_dependency_has_a_version_that_is_installed():
    fixed = {
        line.split("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
    }
    for one in PROJECT["dependencies"]:
        assert re.split(r"[<>=]", one)[0].lower().replace("_", "-") in fixed


FACES_STRANGERS = (
    "mcap",
    "zstandard",
    "lz4",
    "pyarrow",
    "msgspec",
    "starlette",
    "uvicorn",
    "h11",
    "prometheus_client",
    "cflib",
    "rosbags",
    "pyulog",
    "distributed",
)
"""What takes apart requests, or packets and files of others."""


def test_what_faces_strangers_is_asked_for_in_no_older_version_than_is_tested():
    asked = [*PROJECT["dependencies"]]
    for name in ("radio", "logs", "fleet"):
        asked += EXTRAS[name]
    tested = dict(
        line.split("==") for line in (ROOT / "constraints.txt").read_text().split() if "==" in line
    )
    least = dict(one.split(">=") for one in asked if ">=" in one)
    for name in FACES_STRANGERS:
        asked_for = least[name].split(".")
        assert tested[name].split(".")[: len(asked_for)][:2] == asked_for[:2], name


def test_what_the_program_imports_is_declared():
    """What comes along with another package may cease to."""
    names = {re.split(r"[<>=]", one)[0].lower().replace("-", "_") for one in ASKED}
    known = names | {MODULES.get(name, name) for name in names}
    imported = set()
    for path in (ROOT / "groundstation").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {(one.name.split(".")[0], path.name) for one in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add(((node.module or "").split(".")[0], path.name))
    own = {"", "groundstation", "firmware_sim", *BROUGHT, *sys.stdlib_module_names}
    assert {one for one in imported if one[0] not in known | own} == set()


MODULES = {
    "pyusb": "usb",
    "pyserial": "serial",
    "rerun_sdk": "rerun",
    "pillow": "PIL",
}
"""Package -> what it is imported as."""
BROUGHT = frozenset({"dask", "fsspec", "llvmlite", "apsw"})
"""Parts of what distributed, numba and rosbags are: used with those alone."""
