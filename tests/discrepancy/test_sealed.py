"""Hidden effects, found by the installed command in a process that sees recordings and a model.

A stable slice of the matrix that ``make bench-discrepancy`` runs.
"""

from __future__ import annotations

import json

import pytest

from bench.command import run_command
from bench.sealed.cases import named
from bench.sealed.flights import Generator
from bench.sealed.judge import judge
from bench.sealed.run import search_arguments

HIDDEN = "single:motor_braking_asymmetry:0:affected"


@pytest.fixture(scope="module")
def generator(tmp_path_factory):
    return Generator(tmp_path_factory.mktemp("families"))


def made(generator, name, folder):
    """The recordings of a case and its sealed truth; nothing else is in the folder."""
    sealed = generator.make(named(name), folder)
    assert sorted(path.name for path in folder.iterdir()) == [
        "fit1.mcap",
        "fit2.mcap",
        "model.json",
        "validate.mcap",
    ]
    return sealed


def opened(name, sealed, folder):
    """(the judgement, the report)"""
    report = json.loads((folder / "report.json").read_text())
    return judge(named(name), sealed, report), report


@pytest.mark.timeout(1200)
def test_what_is_hidden_is_named_and_nothing_else_and_the_gap_closes(generator, tmp_path):
    sealed = made(generator, HIDDEN, tmp_path / "seen")
    assert run_command(*search_arguments(tmp_path / "seen")).said == ""
    line, report = opened(HIDDEN, sealed, tmp_path / "seen")
    assert line["counted"]
    assert sorted(line["found"]) == sorted(named(HIDDEN).names)
    assert report["verdict"] == "effects_found"
    assert line["explained"] >= 0.9
    assert line["where_right"], line["where"]
    assert report["residual"] == "white"
    assert report["gap"]["validation"]["after"] == pytest.approx(1.0, abs=0.05)
    for one in line["parameters"]:
        assert one["value"] == pytest.approx(one["truth"], abs=4.0 * one["stderr"])


def test_a_refusal_is_what_the_command_complained_of(tmp_path):
    ended = run_command("discrepancy", tmp_path / "absent.mcap", "--model", "thesis")
    assert "absent.mcap" in ended.said
    assert ended.seconds > 0.0
