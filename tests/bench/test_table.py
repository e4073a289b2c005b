"""The bench's one table."""

import json
import sys
from pathlib import Path

import pytest

from bench import __main__ as bench
from bench.table import Row, header
from support.programs import run_program

ROOT = Path(__file__).parents[2]


def test_a_figure_stands_beside_its_reference_and_their_ratio():
    row = Row("loop (bare loop)", 90.0, 100.0, "M/s")
    assert row.ratio == pytest.approx(0.9)
    assert row.met is None
    assert row.line().split() == ["loop", "(bare", "loop)", "90", "100", "0.9", "-", "M/s"]


@pytest.mark.parametrize(
    ("limits", "met", "shown"),
    [
        ({"most": 0.15}, True, "<= 0.15"),
        ({"most": 0.1}, False, "<= 0.1 MISSED"),
        ({"least": 0.12}, True, ">= 0.12"),
        ({"least": 0.2}, False, ">= 0.2 MISSED"),
    ],
)
def test_a_limit_is_shown_and_one_that_is_not_kept_is_marked(limits, met, shown):
    row = Row("processor", 0.12, None, "core", **limits)
    assert row.met is met
    assert f" {shown}  core" in row.line()
    assert row.as_dict("daemon")["met"] is met


def test_columns_are_aligned():
    rows = [Row("short", 1.0, 2.0, "s"), Row("processor (a core)", 123.4, None, "%", most=5)]
    lines = [header(), *(row.line() for row in rows)]
    assert {line.rfind("  ") for line in lines} == {len(header()) - len("  unit")}


def test_what_takes_hours_is_no_part_and_every_part_gives_rows():
    parts = bench._parts()
    assert not {"soak", "against", "sealed", "table"} & set(parts)
    assert {"quick", "daemon", "identification", "stop"} <= set(parts)


def test_an_unknown_part_is_a_usage_error_that_names_the_known_ones():
    done = run_program([sys.executable, "-m", "bench", "banana"], cwd=ROOT)
    assert done.returncode == 2
    assert "banana not known; there are daemon, identification" in done.stderr


def test_a_limit_that_is_missed_is_named_at_the_end_which_is_then_a_failure(monkeypatch, capsys):
    rows = [Row("kept", 1.0, 2.0, "s", most=3.0), Row("missed", 9.0, None, "s", most=3.0)]
    monkeypatch.setattr("bench.daemon.rows", lambda: iter(rows))
    monkeypatch.setattr(sys, "argv", ["bench", "--json", "daemon"])
    assert bench.main() == 1
    said = capsys.readouterr()
    assert "limit missed: missed" in said.err
    first, second = json.loads(said.out)
    assert (first["part"], first["ratio"], first["met"]) == ("daemon", 0.5, True)
    assert (second["reference"], second["ratio"], second["met"]) == (None, None, False)
    rows.pop()
    assert bench.main() == 0
