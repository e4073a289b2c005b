"""Every Python example of the pages runs, those of a page in order; public names are listed."""

import re
import sys
from contextlib import nullcontext

import pytest

import groundstation
from support import ROOT
from support.pages import FLOWN, PAGES, blocks_of
from support.programs import run_program

WITH_PYTHON = [
    page for page in PAGES if any(block.language == "python" for block in blocks_of(page))
]
MODELS = ("body.json", "motor.json")


@pytest.mark.timeout(900)  # a quarter of a minute where nothing else runs
@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.name)
def test_the_examples_of_a_page_run_in_order(page, folder, larder, with_station):
    names = {}
    for block in blocks_of(page):
        if block.language == "python":
            for name in (*FLOWN, *MODELS):
                if f'"{name}"' in block.text:
                    larder.give(name, folder)
            code = compile("\n" * (block.line - 1) + block.text, str(page), "exec")
            with with_station() if "socket_path" in block.text else nullcontext():
                exec(code, names)


def test_the_public_names_are_there_and_are_those_that_the_page_lists():
    text = (ROOT / "docs" / "python_api.md").read_text()
    table = text[text.index("| for | names |") : text.index("In memory")]
    assert set(re.findall(r"`(\w+)`", table)) == set(groundstation.__all__)
    for name in groundstation.__all__:
        assert getattr(groundstation, name).__doc__, name
    assert set(groundstation.__all__) <= set(dir(groundstation))


def test_names_of_the_first_version_are_those_of_today():
    for former, name in groundstation.FORMER.items():
        assert getattr(groundstation, former) is getattr(groundstation, name)


def test_a_type_checker_sees_what_each_public_name_is(tmp_path):
    names = [*groundstation.__all__, *groundstation.FORMER]
    program = tmp_path / "program.py"
    program.write_text(
        f"from groundstation import {', '.join(names)}, nonsense\n"
        + "".join(f"reveal_type({name})\n" for name in names)
        + "with Client(socket_path()) as client:\n    reveal_type(client)\n"
    )
    told = run_program([sys.executable, "-m", "mypy", program], cwd=ROOT).stdout
    *types, client = re.findall(r'Revealed type is "(.*)"', told)
    assert len(types) == len(names), told
    assert all(one.startswith("def (") for one in types), told
    assert client == "groundstation.service.client.Client"
    assert 'has no attribute "nonsense"' in told
    assert told.count("error:") == 1, told


def test_a_name_that_is_not_public_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        groundstation.nonsense  # noqa: B018


def test_importing_the_package_loads_nothing_else():
    program = "import sys, groundstation; print(len([m for m in sys.modules if 'numpy' in m]))"
    done = run_program([sys.executable, "-c", program])
    assert done.stdout == "0\n", done.stderr
