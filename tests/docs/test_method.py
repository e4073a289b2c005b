"""docs/method.md beside the code: its modules and its numbers are there."""

import importlib
import re
from collections.abc import Iterator

import pytest

from support import ROOT

PAGE = (ROOT / "docs" / "method.md").read_text()
FOLDERS = {"S": "groundstation/discrepancy", "L": "groundstation/identification/likelihood"}
OTHERS = set(re.findall(r"`(groundstation/\S+)\.py`", PAGE))
UNITS = {"": 1.0, " %": 100.0, " ms": 1000.0}
NUMBERS = re.findall(r"`([A-Z][A-Z_]+)` (\d+(?:\.\d+)?)( %| ms)?", PAGE)


def constants() -> dict[str, list[object]]:
    """Values by name, of the modules of the method."""
    folders = [path for folder in FOLDERS.values() for path in (ROOT / folder).glob("*.py")]
    modules = {str(path.relative_to(ROOT).with_suffix("")) for path in folders} | OTHERS
    found: dict[str, list[object]] = {}
    for module in sorted(modules):
        for name, value in vars(importlib.import_module(module.replace("/", "."))).items():
            if name.isupper():
                found.setdefault(name, []).append(value)
    return found


def numbers_in(value: object) -> Iterator[float]:
    """A number, or those of a tuple and how many they are."""
    if isinstance(value, (int, float)):
        yield float(value)
    elif isinstance(value, tuple):
        yield float(len(value))
        for one in value:
            yield from numbers_in(one)


@pytest.fixture(scope="module")
def known() -> dict[str, list[object]]:
    return constants()


def test_every_module_that_the_page_names_is_there():
    named = re.findall(r"\b([SL])/([a-z_]+)\.py", PAGE)
    assert len(named) > 20
    for letter, module in named:
        assert (ROOT / FOLDERS[letter] / f"{module}.py").is_file(), module


def test_every_number_of_the_page_is_the_one_in_the_code(known):
    assert len(NUMBERS) > 50
    for name, number, unit in NUMBERS:
        values = [one for value in known.get(name, ()) for one in numbers_in(value)]
        wanted = float(number) / UNITS[unit]
        assert any(one == pytest.approx(wanted, rel=1e-9) for one in values), (name, number, values)


def test_every_gate_of_the_code_is_on_the_page(known):
    decide = ("groundstation/discrepancy/acceptance.py", "groundstation/discrepancy/recurrence.py")
    for module in decide:
        text = (ROOT / module).read_text()
        for names in re.findall(r"^([A-Z_]+(?:, [A-Z_]+)*) = [\dL]", text, re.MULTILINE):
            for name in names.split(", "):
                assert f"`{name}`" in PAGE, name
