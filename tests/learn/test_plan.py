"""``plan``: what to fly by hand for what a model leaves open."""

import json
from pathlib import Path

from support.daemons import COMMAND, in_process, require_failure
from support.programs import run_program

MODEL = Path(__file__).parent / "data" / "body.json"
OF_2014 = Path(__file__).parents[1] / "control" / "data" / "body.json"


def test_a_plan_is_a_timeline_within_its_time_with_what_each_manoeuvre_tells(tmp_path):
    words = ["plan", "--model", MODEL, "--seconds", "30", "-o", tmp_path / "plan.json", "--json"]
    result = run_program([COMMAND, *map(str, words)], timeout=280)
    assert result.returncode == 0, result.stderr
    plan = json.loads(result.stdout)
    assert plan == json.loads((tmp_path / "plan.json").read_text())
    rows = plan["timeline"]
    assert rows
    assert rows[-1]["at_s"] + rows[-1]["seconds"] <= 31.0
    assert all(row["gain_nats"] > 0.0 and row["tells"] for row in rows)
    assert min(plan["expected_stderr"].values()) > 0.0


def test_a_model_of_firmware_that_holds_no_place_is_refused():
    line = require_failure(in_process("plan", "--model", OF_2014))
    assert "a crazyflie1 flies firmware 2014, which holds neither height nor place" in line


def test_a_file_that_is_no_model_is_one_line(tmp_path):
    (tmp_path / "m.json").write_text("{}")
    assert "m.json" in require_failure(in_process("plan", "--model", tmp_path / "m.json"))
