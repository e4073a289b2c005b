"""docs/dependencies.md justifies what pyproject.toml asks for: all of it and nothing else."""

import re
import tomllib

from pages import ROOT


def test_every_dependency_is_justified_and_every_row_is_a_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [*project["dependencies"]]
    for extra in project["optional-dependencies"].values():
        asked += extra
    text = (ROOT / "docs" / "dependencies.md").read_text()
    rows = re.findall(r"^\| ([\w.-]+) \|", text, re.MULTILINE)
    assert set(rows) - {"package"} == {re.split(r"[<>=]", one)[0] for one in asked}


def test_every_dependency_has_a_version_that_is_installed():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    fixed = {
        line.split("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
    }
    for one in project["dependencies"]:
        assert re.split(r"[<>=]", one)[0].lower().replace("_", "-") in fixed
