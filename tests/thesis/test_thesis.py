"""The thesis repeated: nothing is missing, and every number has its command."""

import json
import re

import pytest
from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.errors import BadInputError
from groundstation.thesis.catalogue import ENTRIES, chosen
from groundstation.thesis.workshop import RECIPES, WITHOUT, chain, inputs
from support import ROOT

FIGURES = {1: 14, 2: 2, 3: 8, 4: 15, 5: 7, 6: 5, 7: 56, 8: 18}
TABLES = {5: 1, 6: 1, 7: 5, 8: 7}
"""How many the thesis has, by chapter."""


def expanded(text):
    """ "Figures 1.1 to 1.14" and the like, number by number."""
    for kind, numbers in re.findall(r"(Figure|Table)s? ([\d., to]+)", text):
        for part in re.findall(r"(\d+)\.(\d+)(?: to \d+\.(\d+))?", numbers):
            chapter, first, last = part[0], int(part[1]), int(part[2] or part[1])
            yield from (f"{kind} {chapter}.{n}" for n in range(first, last + 1))


def test_every_table_and_figure_has_a_counterpart_or_the_reason_why_not():
    printed = {f"Figure {c}.{n}" for c, last in FIGURES.items() for n in range(1, last + 1)}
    printed |= {f"Table {c}.{n}" for c, last in TABLES.items() for n in range(1, last + 1)}
    made = [one.number for one in ENTRIES if not one.number.startswith("Section")]
    without = [number for text, _ in WITHOUT for number in expanded(text)]
    assert len(set(made + without)) == len(made + without)
    assert set(made + without) == printed


def test_commands_come_after_those_that_make_their_files():
    given = set(inputs())
    for name in RECIPES:
        there = set(given)
        for made in chain(name):
            line = RECIPES[made]
            words = line.replace(f"> {made}", "").replace(f"-o {made}", "").split()
            files = {word for word in words if re.fullmatch(r"\w+\.(csv|json|toml)", word)}
            assert files <= there, line
            there.add(made)


def test_the_excerpt_is_the_recording():
    printed = (ROOT / "recordings" / "thesis_excerpt.csv").read_text()
    assert inputs()["excerpt.csv"] == printed


def test_an_unknown_number_is_refused_with_those_that_there_are():
    with pytest.raises(BadInputError, match=r"--only 9\.9: there are Table 5\.1, Figure 5\.7, "):
        chosen(["9.9"])


def test_a_part_is_made_with_its_page_and_its_commands(tmp_path):
    arguments = ["--only", "Figure 5.7", "--only", "6.4", "--only", "8.5", "--json"]
    done = CliRunner().invoke(app, ["thesis", "-o", str(tmp_path / "some"), *arguments])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    log, axes, errors = said["entries"]
    assert [one["number"] for one in said["entries"]] == ["Figure 5.7", "Figure 6.4", "Table 8.5"]
    assert ["AccZ", "7707", "1.882 g"] in log["tables"][0]["rows"]
    assert "attitude pitch is inverted" in axes["says"]
    assert ["P", "0.5648", "0.6235", "0.5133", "0.3131", "0.3069", "0.3185"] in (
        errors["tables"][0]["rows"]
    )
    page = re.sub("</?span>", "", (tmp_path / "some" / "index.html").read_text())
    assert page.count("<svg") == 3
    for one in said["entries"]:
        for line in one["commands"]:
            assert line.partition(" > ")[0] in page
    script = (tmp_path / "some" / "commands.sh").read_text()
    assert "'groundstation thesis' ran" in script
    assert "python -m groundstation.control.linear_loop > controllers.json" in script


def test_a_folder_that_holds_something_is_refused(tmp_path):
    (tmp_path / "mine").write_text("mine")
    done = CliRunner().invoke(app, ["thesis", "-o", str(tmp_path), "--only", "5.1"])
    assert isinstance(done.exception, BadInputError)
