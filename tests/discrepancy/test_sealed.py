"""Hidden effects, found by the installed command in a process that sees recordings and a model.

A stable slice of the matrix that ``make bench-discrepancy`` runs.
"""

from __future__ import annotations

import json
import os
import subprocess

import pytest

from bench.sealed.cases import named
from bench.sealed.flights import COMMAND, Generator
from bench.sealed.judge import judge
from bench.sealed.run import search_arguments
from bench.sealed.worker import command, main

NOTHING = "quiet:nothing:0:clean"
HIDDEN = (
    "single:velocity_moment:0:clean",
    "single:gyro_low_pass:0:clean",
    "single:motor_braking_asymmetry:0:affected",
)


@pytest.fixture(scope="module")
def generator(tmp_path_factory):
    return Generator(tmp_path_factory.mktemp("families"))


def searched(generator, name, folder):
    """(the judgement, the report): recordings are made, searched, and the seal is opened."""
    sealed = generator.make(named(name), folder / "seen")
    assert sorted(path.name for path in (folder / "seen").iterdir()) == [
        "fit1.mcap",
        "fit2.mcap",
        "model.json",
        "validate.mcap",
    ]
    done = subprocess.run(
        [COMMAND, *search_arguments(folder / "seen")],
        capture_output=True,
        text=True,
        env={**os.environ, "NO_COLOR": "1"},
        timeout=280,
    )
    assert done.returncode == 0, done.stderr
    report = json.loads((folder / "seen" / "report.json").read_text())
    return judge(named(name), sealed, report), report


@pytest.mark.parametrize("name", HIDDEN)
def test_the_hidden_effect_is_named_and_nothing_else(generator, tmp_path, name):
    line, report = searched(generator, name, tmp_path)
    assert line["counted"]
    assert line["found"] == [named(name).names[0]]
    assert report["verdict"] == "effects_found"
    assert line["explained"] >= 0.9
    assert line["where_right"], line["where"]


def test_where_nothing_is_hidden_nothing_is_named(generator, tmp_path):
    line, report = searched(generator, NOTHING, tmp_path)
    assert line["found"] == []
    assert report["verdict"] == "no_discrepancy"


def test_the_worker_answers_a_refusal_in_one_line(tmp_path, monkeypatch, capsys):
    import io

    missing = ["discrepancy", str(tmp_path / "absent.mcap"), "--model", "thesis"]
    monkeypatch.setattr("sys.stdin", io.StringIO(json.dumps(missing) + "\n"))
    main(command)
    answer = json.loads(capsys.readouterr().out)
    assert answer["error"].startswith("refused: ")
    assert "absent.mcap" in answer["error"]
